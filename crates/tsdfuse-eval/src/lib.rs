//! Measures how good a reconstructed mesh is.
//!
//! A mesh is sampled ([`sample`]) and compared with a [`Reference`] (a cloud or a mesh) in both directions by the rules of a
//! [`Protocol`]. The distances become a [`Comparison`]: averages, percentiles, completeness, precision and F-score, for all
//! places and for those that were densely observed. `docs/evaluation.md` explains each figure.
//!
//! All lengths are metres. The same input gives the same figures on any number of threads.
//!
//! ```
//! use tsdfuse::{Mesh, glam::DVec3};
//! use tsdfuse_eval::{Protocol, Reference, compare};
//!
//! let mesh = Mesh {
//!     vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
//!     triangles: vec![[0, 1, 2]],
//!     ..Default::default()
//! };
//! // The same triangle, 3 cm higher.
//! let mut higher = mesh.clone();
//! higher.vertices.iter_mut().for_each(|v| v.z += 0.03);
//! let found = compare(&mesh, &Reference::mesh(higher)?, &Protocol::surface())?;
//! assert!((found.all.mesh_to_reference.stats.mean_m - 0.03).abs() < 1e-9);
//! assert_eq!(found.all.thresholds[0].f_score, 1.0); // at 5 cm
//! # Ok::<(), tsdfuse_eval::EvalError>(())
//! ```

mod bounds;
pub mod color;
pub mod compare;
pub mod dense;
mod error;
mod figures;
pub mod held_out;
pub mod picture;
mod plausible;
pub mod protocol;
pub mod reference;
pub mod sample;
pub mod stats;
pub mod trajectory;
mod voxels;

pub use bounds::Bounds;
pub use compare::{Comparison, compare};
pub use error::{EvalError, Result};
pub use protocol::Protocol;
pub use reference::Reference;
pub use stats::Stats;
pub use tsdfuse::mesh::triangle;

/// Compiles the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
