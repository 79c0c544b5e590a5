//! Depth images: what a pinhole camera sees of a cloud.

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;

use super::{NONE, PART, Pinhole};

/// Depths along the optical axis, metres, row by row from the top left; 0 where nothing was measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthImage {
    /// One entry per pixel of the camera.
    pub depths_m: Vec<f32>,
    /// Points that another one hides: behind it in the same pixel.
    pub hidden: u64,
    /// Points that are not finite or lie outside the image.
    pub outside: u64,
    /// Of each point: its pixel, or [`NONE`], and its depth.
    seen: Vec<(u32, f32)>,
}

impl DepthImage {
    /// Renders points, which `to_camera` brings into the camera's frame (metres); the nearest point of a pixel stays.
    ///
    /// An image that was turned into points, one at the centre of each pixel, comes back as it was.
    pub fn render(&mut self, camera: &Pinhole, points: &[Vec3], to_camera: impl Fn(Vec3) -> Vec3 + Sync) {
        self.depths_m.clear();
        self.depths_m.resize(camera.pixels(), 0.0);
        (self.hidden, self.outside) = (0, 0);
        self.seen.resize(points.len(), (NONE, 0.0));
        let level = Level::new(); // the vector instructions of this CPU
        let parts = points.par_chunks(PART).zip(self.seen.par_chunks_mut(PART));
        parts.for_each(|(points, seen)| {
            dispatch!(level, _ => for (&point, seen) in points.iter().zip(seen) {
                let point = to_camera(point);
                let pixel = camera.pixel(point).filter(|_| point.x < f32::MAX);
                *seen = (pixel.map_or(NONE, |pixel| pixel as u32), point.x);
            });
        });
        for &(pixel, depth_m) in &self.seen {
            let Some(depth) = self.depths_m.get_mut(pixel as usize) else {
                self.outside += 1;
                continue;
            };
            self.hidden += u64::from(*depth != 0.0);
            if *depth == 0.0 || depth_m < *depth {
                *depth = depth_m;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_become_points_and_images_again() {
        let camera = Pinhole::with_fov(64, 48, 1.0);
        let depths: Vec<f32> = (0..camera.pixels())
            .map(|i| if i % 7 == 0 { 0.0 } else { 0.3 + 0.01 * i as f32 })
            .collect();
        let points = depths.iter().enumerate().filter(|(_, d)| **d > 0.0);
        let points = points.map(|(i, d)| camera.ray((i % 64) as f32, (i / 64) as f32) * *d);
        let mut image = DepthImage::default();
        image.render(&camera, &points.collect::<Vec<_>>(), |p| p);
        assert_eq!(image.depths_m, depths);
        assert_eq!((image.hidden, image.outside), (0, 0));
    }

    #[test]
    fn the_nearest_point_of_a_pixel_stays() {
        let camera = Pinhole::with_fov(3, 3, 1.0);
        let mut image = DepthImage::default();
        let points = [Vec3::X * 3.0, Vec3::X * 2.0, Vec3::X * 5.0, -Vec3::X, Vec3::NAN];
        image.render(&camera, &points, |p| p);
        assert_eq!(image.depths_m, [0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!((image.hidden, image.outside), (2, 2));
    }
}
