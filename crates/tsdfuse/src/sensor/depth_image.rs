//! Depth images: what a pinhole camera sees of a cloud.

use glam::Vec3;

use super::Pinhole;

/// Depths along the optical axis, metres, row by row from the top left; 0 where nothing was measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthImage {
    /// One entry per pixel of the camera.
    pub depths_m: Vec<f32>,
    /// Points that another one hides: behind it in the same pixel.
    pub hidden: u64,
    /// Points that are not finite or lie outside the image.
    pub outside: u64,
}

impl DepthImage {
    /// Renders points (sensor frame, metres); the nearest point of a pixel stays.
    ///
    /// An image that was turned into points, one at the centre of each pixel, comes back as it was.
    pub fn render(&mut self, camera: &Pinhole, points: impl Iterator<Item = Vec3>) {
        self.depths_m.clear();
        self.depths_m.resize(camera.pixels(), 0.0);
        (self.hidden, self.outside) = (0, 0);
        for point in points {
            let Some(pixel) = camera.pixel(point).filter(|_| point.x < f32::MAX) else {
                self.outside += 1;
                continue;
            };
            let depth = &mut self.depths_m[pixel];
            if *depth != 0.0 {
                self.hidden += 1;
            }
            if *depth == 0.0 || point.x < *depth {
                *depth = point.x;
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
        image.render(&camera, points);
        assert_eq!(image.depths_m, depths);
        assert_eq!((image.hidden, image.outside), (0, 0));
    }

    #[test]
    fn the_nearest_point_of_a_pixel_stays() {
        let camera = Pinhole::with_fov(3, 3, 1.0);
        let mut image = DepthImage::default();
        let points = [3.0, 2.0, 5.0].map(|depth| Vec3::X * depth);
        image.render(&camera, points.into_iter().chain([-Vec3::X, Vec3::NAN]));
        assert_eq!(image.depths_m, [0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!((image.hidden, image.outside), (2, 2));
    }
}
