//! A surface in the browser, to be looked at from everywhere: turned, flown through, measured, cut at a height.
//!
//! [`page::write`] makes one file that needs no network: the viewer, the surface, the sensor's path, figures. The surface is
//! quantised and deflated ([`pack`]): 8 to 12 bytes a triangle become 3 to 5.
//!
//! ```
//! use tsdfuse::{Mesh, glam::{DVec3, Vec3}};
//! use tsdfuse_view::{Scene, Surface, page};
//! # let dir = tempfile::tempdir()?;
//! let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
//! let mesh = Mesh { vertices: corners.to_vec(), normals: vec![Vec3::Z; 3], triangles: vec![[0, 1, 2]] };
//! let scene = Scene { title: "a triangle".to_owned(), ..Scene::default() };
//! let written = page::write(&dir.path().join("triangle.html"), &scene, &Surface::of(&mesh))?;
//! assert_eq!(written.triangles, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod chunks;
mod cluster;
#[cfg(feature = "live")]
pub mod live;
pub mod pack;
pub mod page;
mod scene;

pub use scene::{Channel, Paint, Ramp, Scene, Surface, add_normals};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
