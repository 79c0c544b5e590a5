//! Pinhole cameras: depth cameras, and the virtual ones through which a LiDAR's returns or a map are looked at.
//!
//! ```text
//!        (0, 0) ┌────────────────┐  u →          sensor frame: x forward (the optical axis), y left, z up
//!               │       x ●      │               u = cx − fx·y/x      v = cy − fy·z/x      depth = x
//!             v ↓                │
//!               └────────────────┘ (width, height)    pixel (0, 0) has its centre at u = 0, v = 0
//! ```
//!
//! Intrinsics are those of OpenCV; frames are ours: a point (x, y, z) of the optical frame (right, down, forward) is
//! (z, −x, −y) here.

use fearless_simd::{Simd, f32x8, i32x8, mask32x8, prelude::*};
use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::index::ROUND;

/// The intrinsics of a pinhole camera without distortion, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pinhole {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length across.
    pub fx: f32,
    /// Focal length down.
    pub fy: f32,
    /// Column of the principal point.
    pub cx: f32,
    /// Row of the principal point.
    pub cy: f32,
}

/// Why numbers are not a camera.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PinholeError {
    /// An image has pixels, and not more than fit into memory.
    #[error("an image of {width} x {height} pixels; 1 x 1 to {MAX_IMAGE_EDGE} x {MAX_IMAGE_EDGE} are possible")]
    Size {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Focal lengths are positive.
    #[error("focal lengths of {fx} and {fy} pixels; they must be positive")]
    Focal {
        /// Across.
        fx: f32,
        /// Down.
        fy: f32,
    },
    /// The principal point of an image that was not cut lies near its middle.
    #[error(
        "the principal point ({cx}, {cy}) is far from the middle of an image of {width} x {height} pixels: these are the \
         intrinsics of an image of another size"
    )]
    Principal {
        /// Column.
        cx: f32,
        /// Row.
        cy: f32,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
}

/// More pixels than any depth camera has in a row; also bounds the memory of an image.
pub const MAX_IMAGE_EDGE: u32 = 16_384;

/// How far the principal point may be from the middle of the image, as a share of its edge.
const OFF_MIDDLE: f32 = 0.2;

impl Pinhole {
    /// A camera with square pixels whose image spans `horizontal_fov_rad` from border to border.
    pub fn with_fov(width: u32, height: u32, horizontal_fov_rad: f32) -> Self {
        let focal = 0.5 * width as f32 / (0.5 * horizontal_fov_rad).tan();
        Self {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: 0.5 * width as f32 - 0.5,
            cy: 0.5 * height as f32 - 0.5,
        }
    }

    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// [`PinholeError`] tells which number and why.
    pub fn check(&self) -> Result<(), PinholeError> {
        let Self {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        } = *self;
        if !((1..=MAX_IMAGE_EDGE).contains(&width) && (1..=MAX_IMAGE_EDGE).contains(&height)) {
            return Err(PinholeError::Size { width, height });
        }
        if !(fx > 0.0 && fy > 0.0 && fx.is_finite() && fy.is_finite()) {
            return Err(PinholeError::Focal { fx, fy });
        }
        let near_middle = |c: f32, edge: u32| (c / edge as f32 - 0.5).abs() <= OFF_MIDDLE;
        // Also false for NaN.
        if !(near_middle(cx, width) && near_middle(cy, height)) {
            return Err(PinholeError::Principal { cx, cy, width, height });
        }
        Ok(())
    }

    /// How many pixels there are.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Column and row at which a point in front of the camera (sensor frame) is seen, also outside the image; whole numbers
    /// are centres of pixels. Not finite for points beside or behind the camera.
    #[inline(always)]
    pub fn project(&self, point: Vec3) -> (f32, f32) {
        let inverse = 1.0 / if point.x > 0.0 { point.x } else { 0.0 };
        (
            self.cx - self.fx * point.y * inverse,
            self.cy - self.fy * point.z * inverse,
        )
    }

    /// The pixel in which a point (sensor frame) is seen, numbered row by row; `None` outside the image.
    #[inline(always)]
    pub fn pixel(&self, point: Vec3) -> Option<usize> {
        self.pixel_at(self.project(point))
    }

    /// The pixel that holds a place in the image, numbered row by row; `None` outside.
    #[inline(always)]
    pub fn pixel_at(&self, (u, v): (f32, f32)) -> Option<usize> {
        // Also false for NaN.
        let inside = u >= -0.5 && v >= -0.5 && u < self.width as f32 - 0.5 && v < self.height as f32 - 0.5;
        // Not negative, so that truncation is the floor.
        inside.then(|| (u + 0.5) as usize + (v + 0.5) as usize * self.width as usize)
    }

    /// [`Self::pixel_at`] for eight places: whether they are inside, and the numbers of their pixels (0 outside).
    #[inline(always)]
    pub(crate) fn pixels_at<S: Simd>(&self, u: f32x8<S>, v: f32x8<S>) -> (mask32x8<S>, [i32; 8]) {
        let inside = u.simd_ge(-0.5)
            & v.simd_ge(-0.5)
            & u.simd_lt(self.width as f32 - 0.5)
            & v.simd_lt(self.height as f32 - 0.5);
        let pixel = whole(u + 0.5) + whole(v + 0.5) * self.width as i32;
        let none = i32x8::splat(pixel.token(), 0);
        (inside, inside.select(pixel, none).into())
    }

    /// The point at depth 1 (sensor frame) that is seen at column `u` and row `v`: the inverse of [`Pinhole::project`].
    #[inline(always)]
    pub fn ray(&self, u: f32, v: f32) -> Vec3 {
        Vec3::new(1.0, (self.cx - u) / self.fx, (self.cy - v) / self.fy)
    }
}

/// The largest whole numbers not above these, all within ±2²².
#[inline(always)]
pub(super) fn whole<S: Simd>(v: f32x8<S>) -> i32x8<S> {
    (v.floor() + ROUND).bitcast::<i32x8<S>>() - ROUND.to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KINECT: Pinhole = Pinhole {
        width: 640,
        height: 480,
        fx: 585.0,
        fy: 580.0,
        cx: 320.0,
        cy: 240.0,
    };

    proptest! {
        #[test]
        fn pixels_survive_the_round_trip(u in 0..640u32, v in 0..480u32, depth in 0.01..100f32) {
            let point = KINECT.ray(u as f32, v as f32) * depth;
            prop_assert_eq!(point.x, depth);
            prop_assert_eq!(KINECT.pixel(point), Some((v * 640 + u) as usize));
        }

        #[test]
        fn directions_survive_the_round_trip(y in -2.0..2.0f32, z in -2.0..2.0f32, x in 0.1..50f32) {
            let (u, v) = KINECT.project(Vec3::new(x, y, z));
            prop_assert!(KINECT.ray(u, v).distance(Vec3::new(x, y, z) / x) < 1e-4);
        }
    }

    #[test]
    fn what_is_outside_has_no_pixel() {
        for point in [
            -Vec3::X,
            Vec3::Y,
            Vec3::ZERO,
            Vec3::NAN,
            Vec3::new(1.0, 0.6, 0.0),
            Vec3::new(1.0, 0.0, -0.5),
        ] {
            assert_eq!(KINECT.pixel(point), None, "{point}");
        }
        let right_below = Vec3::new(2.0, -0.5, -0.5);
        let (u, v) = KINECT.project(right_below);
        assert!(u > 320.0 && v > 240.0);
    }

    #[test]
    fn a_field_of_view_reaches_from_border_to_border() {
        let camera = Pinhole::with_fov(100, 50, std::f32::consts::FRAC_PI_2);
        let left = camera.ray(-0.5, 24.5);
        assert!(left.distance(Vec3::new(1.0, 1.0, 0.0)) < 1e-5, "{left}");
        assert!(camera.check().is_ok());
    }

    #[test]
    fn intrinsics_of_another_image_are_refused() {
        let with = |f: fn(&mut Pinhole)| {
            let mut camera = KINECT;
            f(&mut camera);
            camera.check().unwrap_err().to_string()
        };
        assert!(
            with(|c| (c.width, c.height) = (320, 240))
                .contains("(320, 240) is far from the middle of an image of 320 x 240")
        );
        assert!(with(|c| c.cy = f32::NAN).contains("another size"));
        assert!(with(|c| c.fx = -1.0).contains("focal lengths of -1 and 580"));
        assert!(with(|c| c.width = 0).contains("0 x 480"));
    }
}
