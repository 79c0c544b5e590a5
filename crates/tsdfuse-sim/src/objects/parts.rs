//! Building things from primitives.

use glam::{DQuat, DVec2, DVec3};
use rand::RngExt;
use tsdfuse::Pose;

use crate::primitive::Primitive;

/// The generator of all variation: the same numbers on every platform.
pub(crate) type Rng = rand_chacha::ChaCha8Rng;

/// How deep things are set into a hall's floor, which is plane.
pub(crate) const SUNK_M: f64 = 0.01;

/// How deep things are set into the ground.
pub(crate) const FOOTING_M: f64 = 0.15;

/// One of several.
pub(crate) fn pick<T: Copy>(rng: &mut Rng, choices: &[T]) -> T {
    choices[rng.random_range(0..choices.len() as u32) as usize]
}

/// Solids, each with the reflectivity that was set last.
pub(crate) struct Parts {
    pub(crate) solids: Vec<Primitive>,
    reflectivity: f64,
}

/// A hole in a wall: from (x, z) to (x, z).
#[derive(Clone, Copy)]
pub(crate) struct Opening {
    pub(crate) x: [f64; 2],
    pub(crate) z: [f64; 2],
}

impl Parts {
    /// None yet; what is added reflects this share of light.
    pub(crate) fn of(reflectivity: f64) -> Self {
        Self {
            solids: Vec::new(),
            reflectivity,
        }
    }

    /// Sets the share of light that later parts reflect.
    pub(crate) fn material(&mut self, reflectivity: f64) {
        self.reflectivity = reflectivity;
    }

    /// Adds one solid.
    pub(crate) fn add(&mut self, solid: Primitive) {
        self.solids.push(solid.reflecting(self.reflectivity));
    }

    /// Adds a box between two corners.
    pub(crate) fn block(&mut self, low: [f64; 3], high: [f64; 3]) {
        let (low, high) = (DVec3::from(low), DVec3::from(high));
        let centre = (low + high) / 2.0;
        self.add(Primitive::cuboid(high - low).at(centre.x, centre.y, centre.z));
    }

    /// Adds a cylinder between two points.
    pub(crate) fn tube(&mut self, from: [f64; 3], to: [f64; 3], radius: f64) {
        self.cone(from, to, radius, radius);
    }

    /// Adds a cone frustum between two points.
    pub(crate) fn cone(&mut self, from: [f64; 3], to: [f64; 3], from_radius: f64, to_radius: f64) {
        self.add(Primitive::tube(from.into(), to.into(), from_radius, to_radius));
    }

    /// Adds an ellipsoid.
    pub(crate) fn ball(&mut self, centre: [f64; 3], half_axes: [f64; 3]) {
        let [x, y, z] = centre;
        self.add(Primitive::ellipsoid(half_axes.into()).at(x, y, z));
    }

    /// Adds an (x, z) outline, extruded between two y.
    pub(crate) fn profile(&mut self, outline: &[[f64; 2]], y: [f64; 2]) {
        let outline = outline.iter().copied().map(DVec2::from).collect();
        self.add(Primitive::profile(outline, y[1] - y[0]).at(0.0, (y[0] + y[1]) / 2.0, 0.0));
    }

    /// Adds another thing, moved.
    pub(crate) fn put(&mut self, thing: Self, x: f64, y: f64, z: f64, yaw_rad: f64) {
        self.place(
            thing,
            &Pose {
                rotation: DQuat::from_rotation_z(yaw_rad),
                translation: DVec3::new(x, y, z),
            },
        );
    }

    /// Adds another thing, moved and turned.
    pub(crate) fn place(&mut self, thing: Self, pose: &Pose) {
        self.solids.extend(thing.solids.into_iter().map(|s| s.placed(pose)));
    }

    /// A wall over x and z between two y, with openings. Openings that share the same x stand above one another; those at
    /// other x must be apart. Made of full-height piers and of what is between the openings.
    pub(crate) fn pierced_wall(&mut self, x: [f64; 2], y: [f64; 2], z: [f64; 2], openings: &[Opening]) {
        let mut openings = openings.to_vec();
        openings.sort_by(|a, b| a.x[0].total_cmp(&b.x[0]).then(a.z[0].total_cmp(&b.z[0])));
        let mut pier_start = x[0];
        for column in openings.chunk_by(|a, b| a.x == b.x) {
            let [left, right] = column[0].x;
            self.block([pier_start, y[0], z[0]], [left, y[1], z[1]]);
            // Reaching into the piers, so that the wall is one solid.
            let overlap = 0.5 * (left - pier_start).min(0.1);
            let mut bottom = z[0];
            for top in column.iter().map(|o| o.z).chain([[z[1], z[1]]]) {
                if top[0] - bottom > 1e-6 {
                    self.block([left - overlap, y[0], bottom], [right + 0.05, y[1], top[0]]);
                }
                bottom = top[1];
            }
            pier_start = right;
        }
        self.block([pier_start, y[0], z[0]], [x[1], y[1], z[1]]);
    }

    /// A straight railing: posts, two rails. From one (x, y, z) at floor level to another; also sloping.
    pub(crate) fn railing(&mut self, from: [f64; 3], to: [f64; 3], height: f64, spacing: f64) {
        let (a, b) = (DVec3::from(from), DVec3::from(to));
        let posts = (a.distance(b) / spacing).ceil().max(1.0) as u32;
        for i in 0..=posts {
            let foot = a.lerp(b, f64::from(i) / f64::from(posts));
            self.tube(
                (foot - DVec3::Z * 0.06).into(),
                (foot + DVec3::Z * height).into(),
                0.014,
            );
        }
        for level in [0.5 * height, height] {
            let up = DVec3::Z * level;
            self.tube((a + up).into(), (b + up).into(), 0.02);
        }
    }

    /// Steps up along +x from x = 0: their outline from the side, down to `base` below the ground.
    pub(crate) fn steps(&mut self, count: u32, rise: f64, going: f64, base: f64, y: [f64; 2]) {
        let mut outline = vec![[0.0, -base]];
        for i in 0..count {
            let (x, top) = (going * f64::from(i), rise * f64::from(i + 1));
            outline.extend([[x, top], [x + going, top]]);
        }
        outline.push([going * f64::from(count), -base]);
        self.profile(&outline, y);
    }
}
