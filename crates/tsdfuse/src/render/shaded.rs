//! Views as pictures for people: light from the sky and from beside the camera, dark edges, a horizon.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::camera::Camera;
use super::image::{Image, Pixels};
use super::view::{Hit, View};
use crate::Pose;

/// Where the sun stands, world.
const SUN: Vec3 = Vec3::new(-0.38, -0.52, 0.765);

/// The colour of surface in full light.
const SURFACE: Vec3 = Vec3::new(0.90, 0.885, 0.86);

/// The sky above, and at the horizon; the ground where nothing was observed.
const SKY: Vec3 = Vec3::new(0.50, 0.66, 0.84);
/// See [`SKY`].
const HORIZON: Vec3 = Vec3::new(0.90, 0.93, 0.96);
/// See [`SKY`].
const GROUND: Vec3 = Vec3::new(0.40, 0.45, 0.51);

/// Rings of neighbours, pixels of an image 720 high, that tell edges and hollows.
const RINGS: [f32; 3] = [1.0, 3.0, 8.0];

/// How dark edges are.
const EDGES: f32 = 9.0;

/// Differences of logarithms of depth that count at most: a far background is not blacker than a near one.
const MOST_STEP: f32 = 0.05;

impl View {
    /// The view as a picture for people. Surface is `color` (sRGB, 0 to 1) of a pixel and its hit; [`View::shaded`] takes one colour.
    /// Edges and hollows are darkened by how much nearer their neighbours are (eye-dome lighting, Boucheny 2009). `camera` and `pose`
    /// (`world_from_camera`) are those of the view.
    pub fn lit(&self, camera: &Camera, pose: Pose, color: impl Fn(usize, &Hit) -> Vec3 + Sync) -> Image {
        let rays = camera.rays();
        let log_depths: Vec<f32> = self
            .hits
            .par_iter()
            .map(|hit| hit.as_ref().map_or(f32::INFINITY, |hit| hit.range_m.ln()))
            .collect();
        let reach = (self.height as f32 / 720.0).max(1.0);
        let pixel = |i: usize| {
            let (column, row) = (i % self.width, i / self.width);
            let shown = match &self.hits[i] {
                Some(hit) => {
                    let dark = (-EDGES * self.hollow(&log_depths, [column, row], reach)).exp();
                    color(i, hit) * light(hit) * dark
                }
                None => background(pose.rotation * rays.of(column, row).0),
            };
            shown.to_array().map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)
        };
        Image {
            width: self.width,
            height: self.height,
            pixels: Pixels::Rgb((0..self.hits.len()).into_par_iter().map(pixel).collect()),
        }
    }

    /// The view as a picture for people, all surface of one colour ([`View::lit`]).
    pub fn shaded(&self, camera: &Camera, pose: Pose) -> Image {
        self.lit(camera, pose, |_, _| SURFACE)
    }

    /// How far the neighbours are nearer than a pixel, in the mean, as differences of logarithms.
    fn hollow(&self, log_depths: &[f32], [column, row]: [usize; 2], reach: f32) -> f32 {
        let here = log_depths[row * self.width + column];
        let mut sum = 0.0;
        for ring in RINGS {
            let r = (ring * reach).round() as isize;
            for (dx, dy) in [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)] {
                let (x, y) = (column as isize + r * dx, row as isize + r * dy);
                let is_in = x >= 0 && y >= 0 && x < self.width as isize && y < self.height as isize;
                if is_in {
                    // Towards the opposite side a plane rises as it falls here: only what is nearer than that counts.
                    let there = log_depths[y as usize * self.width + x as usize];
                    let (x, y) = (column as isize - r * dx, row as isize - r * dy);
                    let is_in = x >= 0 && y >= 0 && x < self.width as isize && y < self.height as isize;
                    let across = if is_in {
                        log_depths[y as usize * self.width + x as usize]
                    } else {
                        here
                    };
                    let across = if across.is_finite() { across } else { here };
                    sum += (here - there - (across - here).max(0.0)).clamp(0.0, MOST_STEP);
                }
            }
        }
        sum / (8 * RINGS.len()) as f32
    }
}

/// Light on a surface: from the sky, from the sun on the side where it stands, and from a lamp beside the camera.
fn light(hit: &Hit) -> f32 {
    let sky = 0.5 + 0.5 * hit.normal.z;
    let sun = hit.normal.dot(SUN).max(0.0);
    0.30 + 0.26 * sky + 0.30 * sun + 0.22 * hit.incidence_cos.abs()
}

/// What a ray sees that meets nothing.
fn background(direction: DVec3) -> Vec3 {
    let up = direction.normalize_or_zero().z as f32;
    if up >= 0.0 {
        HORIZON.lerp(SKY, (2.2 * up).min(1.0))
    } else {
        HORIZON.lerp(GROUND, (-5.0 * up).min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Pinhole;

    fn hit(range_m: f32, normal: Vec3) -> Option<Hit> {
        Some(Hit {
            range_m,
            depth_m: range_m,
            normal,
            incidence_cos: 0.7,
            weight: 1.0,
        })
    }

    #[test]
    fn edges_are_dark_planes_are_even_and_the_sky_is_above() {
        let camera = Camera::Pinhole(Pinhole::with_fov(60, 60, 1.0));
        let mut hits = vec![None; 3600];
        for row in 20..60 {
            for column in 0..60 {
                // A floor that comes nearer downward, and before it a box.
                let is_box = (20..40).contains(&column) && row > 30;
                let floor = 400.0 / (row as f32 - 10.0);
                hits[row * 60 + column] = hit(if is_box { 5.0 } else { floor }, Vec3::Z);
            }
        }
        let view = View {
            width: 60,
            height: 60,
            hits,
        };
        let Pixels::Rgb(pixels) = view.shaded(&camera, Pose::IDENTITY).pixels else {
            panic!("colours are wanted")
        };
        let at = |column: usize, row: usize| i32::from(pixels[row * 60 + column][0]);
        // Beside the box, behind it: dark; far from it, and on it: bright.
        assert!(at(18, 40) < at(5, 40) - 25, "{} {}", at(18, 40), at(5, 40));
        assert!((at(30, 45) - at(30, 48)).abs() < 3);
        let [r, g, b] = pixels[0];
        assert!(b > r && b > 200 && g > r);
        // Colours of pixels are lit as well.
        let Pixels::Rgb(red) = view.lit(&camera, Pose::IDENTITY, |_, _| Vec3::X).pixels else {
            panic!("colours are wanted")
        };
        assert!(red[45 * 60 + 30][0] > 150 && red[45 * 60 + 30][1] == 0);
    }
}
