//! Views of a map: the zero level of its field, met by a ray for each pixel (thesis 5.1, as in InfiniTAM).
//!
//! ```
//! use tsdfuse::render::{Camera, ImageKind, Renderer};
//! use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3, sensor::Pinhole};
//! # let wall = (-30..30).flat_map(|y| (-20..20).map(move |z| Vec3::new(4.0, 0.03 * y as f32, 0.03 * z as f32)));
//! # let mut map = VoxelMap::new(MapConfig::default())?;
//! # Raycast::default().integrate(&mut map, &Scan { points: wall.collect(), pose: Some(Pose::IDENTITY), ..Default::default() })?;
//!
//! let renderer = Renderer::new(&map, &Default::default())?; // once for any number of views
//! let camera = Camera::Pinhole(Pinhole::with_fov(64, 48, 0.2));
//! let view = renderer.view(&camera, Pose::IDENTITY)?;
//! let hit = view.hit(32, 24).ok_or("nothing ahead")?;
//! assert!((hit.depth_m - 4.0).abs() < 0.01 && hit.normal.x < -0.9);
//! let picture = view.image(ImageKind::Shaded); // pixels; `tsdfuse_io::png` writes them
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **What is seen.** Between eight neighbouring voxel centres that were all observed, the field is trilinear. A ray ends where
//! it first falls from F ≥ 0 to F < 0; this point is found exactly. Nothing is seen where one of the eight was never observed.
//! So views invent no surface: they show exactly the cells from which [`crate::mesh`] makes triangles.
//!
//! **What is not.** A ray passes through surface from behind (F rises from negative to positive), as in InfiniTAM. So walls and
//! ceilings that were only seen from inside are transparent from outside, and one can look into a room from above.

mod camera;
mod cast;
mod cell;
mod config;
mod field;
mod image;
mod orbit;
mod plan;
mod renderer;
mod shaded;
#[cfg(test)]
mod tests;
mod tree;
mod view;
mod walk;

pub use camera::{Camera, Rays};
pub use cast::Ray;
pub use config::{RenderConfig, RenderError};
pub(crate) use image::normal_color;
pub use image::{DEPTH_PER_M, Image, ImageKind, Pixels, WEIGHT_RANGE, viridis};
pub use orbit::{flight, overview, turntable};
pub use plan::plan;
pub use renderer::{Renderer, render};
pub use view::{Hit, View};
