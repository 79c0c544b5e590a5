//! What sticks out of the surfaces along a direction, as niches, lamps and signs do in a tunnel: it tells where along the direction the sensor is.
//!
//! A tunnel's wall must have no say, however little of it is known: beams meet it at the same distances from the sensor again and again, in a pattern
//! that moves with the sensor and would hold it in place.

use std::collections::VecDeque;
use std::f32::consts::TAU;

use glam::{DVec3, IVec2, Vec2, Vec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::cells::{Cells, Plane};
use crate::motion::Motion;
use crate::returns::{GRAIN, Return};

/// Planes whose normals have less than this share along a direction lie along it.
pub(crate) const LEAST_SHARE: f64 = 0.3;

/// Returns beside each other along a direction, farther apart than the first, nearer than the second, lie on a surface along it if they are not farther
/// from each other across it than the third, metres.
const ON_LINE_M: (f64, f64, f64) = (1.2, 6.0, 0.1);

/// How far along a direction planes are looked for that a return lies on, metres.
const REACH_M: f64 = 2.0;

/// A rougher plane does not say whether a return lies on it (standard deviation of a return, metres).
const SHARP_M: f64 = 0.035;

/// Farther away too few returns lie on what sticks out, metres.
const FARTHEST_M: f32 = 60.0;

/// Sweeps that are remembered.
const REMEMBERED: usize = 20;

/// What two sweeps saw is the same thing only if it is not farther from each other across the direction, metres.
const SAME_THING_M: f64 = 0.4;

/// Bearings that differ less may be those of the same beam, radians.
const SAME_BEAM: f32 = 0.005;

/// Points by where they lie across a direction.
struct Lines {
    direction: DVec3,
    across: [DVec3; 2],
    /// How far a point may lie beside a line, metres.
    width: f64,
    points: Vec<DVec3>,
    columns: FxHashMap<IVec2, Vec<usize>>,
}

impl Lines {
    fn of(points: Vec<DVec3>, direction: DVec3, width: f64) -> Self {
        let (u, v) = direction.any_orthonormal_pair();
        let mut this = Self {
            direction,
            across: [u, v],
            width,
            points,
            columns: FxHashMap::default(),
        };
        for (i, point) in this.points.iter().enumerate() {
            this.columns.entry(this.column(*point)).or_default().push(i);
        }
        this
    }

    fn column(&self, x: DVec3) -> IVec2 {
        let [u, v] = self.across.map(|across| (across.dot(x) / self.width).floor() as i32);
        IVec2::new(u, v)
    }

    /// The points beside the line along the direction through a point, and how far along it they lie from there, metres.
    fn beside(&self, x: DVec3) -> impl Iterator<Item = (usize, f64)> {
        let column = self.column(x);
        let around = (-1..=1).flat_map(move |u| (-1..=1).map(move |v| column + IVec2::new(u, v)));
        let near = around.filter_map(|column| self.columns.get(&column)).flatten();
        near.filter_map(move |&i| {
            let off = self.points[i] - x;
            let along = off.dot(self.direction);
            (off.length_squared() - along * along <= self.width * self.width).then_some((i, along))
        })
    }
}

/// The returns that lie on no surface along a direction.
pub(crate) fn sticking_out(cells: &Cells, returns: &[Return], motion: &Motion, direction: DVec3) -> Vec<Return> {
    let placer = motion.placer();
    let placed = returns
        .par_iter()
        .with_min_len(GRAIN)
        .map(|r| placer.place(r.point, r.share));
    let (nearest, farthest, width) = ON_LINE_M;
    let lines = Lines::of(placed.collect(), direction, width);
    let is_on_line = |x| {
        lines
            .beside(x)
            .any(|(_, along)| (nearest..farthest).contains(&along.abs()))
    };
    let sticks_out = |&(r, x): &(&Return, &DVec3)| {
        r.point.length() < FARTHEST_M && !is_on_line(*x) && is_off_planes(cells, *x, direction)
    };
    let chosen = returns.par_iter().zip(&lines.points).with_min_len(GRAIN);
    chosen.filter(sticks_out).map(|(r, _)| *r).collect()
}

/// Whether something was seen along the direction from a point, but no plane that lies along the direction and goes through the point.
fn is_off_planes(cells: &Cells, x: DVec3, direction: DVec3) -> bool {
    let (mut is_seen, mut is_on) = (false, false);
    cells.planes_along(x, direction, REACH_M, 0, |plane: &Plane| {
        let nearest = x + plane.ahead(x, direction).clamp(-REACH_M, REACH_M) * direction;
        let (r, variance) = plane.residual(nearest);
        let is_sharp = variance < SHARP_M * SHARP_M && !plane.faces(direction, LEAST_SHARE);
        is_seen = true;
        is_on |= is_sharp && r * r < 9.0 * variance && plane.reaches(nearest);
    });
    is_seen && !is_on
}

/// What stuck out in the last sweeps, in the world.
#[derive(Clone, Debug, Default)]
pub(crate) struct Remembered {
    sweeps: VecDeque<Vec<Mark>>,
}

/// A return that sticks out.
#[derive(Clone, Copy, Debug)]
struct Mark {
    at: DVec3,
    bearing: Vec2,
}

impl Remembered {
    /// Adds what sticks out in a sweep; the oldest sweep is forgotten.
    pub(crate) fn add(&mut self, sticking: &[Return], motion: &Motion) {
        let placer = motion.placer();
        let mark = |r: &Return| Mark {
            at: placer.place(r.point, r.share),
            bearing: bearing(r.point),
        };
        self.sweeps.push_back(sticking.iter().map(mark).collect());
        if self.sweeps.len() > REMEMBERED {
            self.sweeps.pop_front();
        }
    }

    pub(crate) fn forget(&mut self) {
        self.sweeps.clear();
    }

    pub(crate) fn sweeps(&self) -> usize {
        self.sweeps.len()
    }

    pub(crate) fn along(&self, direction: DVec3) -> Marks {
        let marks: Vec<Mark> = self.sweeps.iter().flatten().copied().collect();
        Marks {
            lines: Lines::of(marks.iter().map(|mark| mark.at).collect(), direction, SAME_THING_M),
            bearings: marks.iter().map(|mark| mark.bearing).collect(),
        }
    }
}

/// What is remembered, by where it lies across a direction.
pub(crate) struct Marks {
    lines: Lines,
    bearings: Vec<Vec2>,
}

impl Marks {
    pub(crate) fn len(&self) -> usize {
        self.bearings.len()
    }

    /// Which marks a return at `x` may be a part of, and how far they lie from it along the direction, metres: up to `reach`. Other beams must have seen
    /// them; the same ones meet any surface at the same distance from the sensor.
    pub(crate) fn beside(&self, x: DVec3, r: &Return, reach: f64) -> Vec<(usize, f64)> {
        let own = bearing(r.point);
        let is_other = |(i, along): &(usize, f64)| {
            let turned = (own - self.bearings[*i]).abs();
            along.abs() < reach && turned.x.min(TAU - turned.x) > SAME_BEAM && turned.y > SAME_BEAM
        };
        self.lines.beside(x).filter(is_other).collect()
    }
}

/// Azimuth and elevation.
fn bearing(p: Vec3) -> Vec2 {
    Vec2::new(p.y.atan2(p.x), p.z.atan2(p.truncate().length()))
}
