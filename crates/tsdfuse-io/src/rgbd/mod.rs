//! Depth images of RGB-D cameras: grey PNG files of 16 bits, and where the camera was.
//!
//! ```text
//! 7-Scenes                                          TUM RGB-D
//! frame-000000.depth.png   units of 1 mm            depth/1305031102.160407.png   units of 0.2 mm
//! frame-000000.pose.txt    4×4 world_from_optical   depth.txt                     time and file of each; or by the names
//! camera-intrinsics.txt    3×3; also a folder above groundtruth.txt               secs x y z qx qy qz qw
//! ```
//!
//! A pixel of 0 or 65535 measured nothing. Colour images are not read. Beside the images may lie
//!
//! - `camera.toml` (also in the folder above): `width`, `height`, `fx`, `fy`, `cx`, `cy` in pixels, and optionally `depth_scale`,
//!   metres per unit; goes before what the layout says,
//! - `mask.png`, for all frames, `mask/NAME.png` in the folder or `NAME.mask.png` beside the image NAME (`frame-000000`,
//!   `1305031102.160407`), for one: grey with 1 or 8 bits; pixels that are 0 in one of them are left out.
//!
//! Poses are of the optical frame (x right, y down, z forward), whatever file they come from; the world stays as it is.
//! Without any poses the frames can be read, but not placed.
//! Points are in the sensor frame (x forward, y left, z up), on the rays through the centres of their pixels.

pub(crate) mod camera;
mod colors;
mod depth_images;
pub(crate) mod image;
mod layout;
pub(crate) mod seven_scenes;
pub(crate) mod tum;

pub(crate) use depth_images::{open, recognises};
pub use layout::OPTICAL_FROM_SENSOR;

#[cfg(test)]
mod tests;
