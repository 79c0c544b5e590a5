//! Surfaces that are too large for one file, as [3D Tiles 1.1](https://docs.ogc.org/cs/22-025r4/22-025r4.html). Web
//! viewers load only the tiles and the level of detail that are in view.
//!
//! ```text
//!   level 0      level 1            level 2
//!   +--+--+      +-----+            +-----------+      edge of a tile: 128 voxels · 2^level (6.4 m at 5 cm for level 0)
//!   +--+--+  ▶   |     |   ▶  …     |           |      a tile: 65,536 triangles or fewer
//!   +--+--+      +-----+            |           |      error: its voxels, 5 cm · 2^level; measured
//!   the surface  8 tiles joined,    +-----------+
//!   as it is     then simplified
//! ```
//!
//! The tree is built from the leaves to the root, cube by cube, and a tile is written as soon as its parent exists. So
//! both the map and the tiles can be larger than memory. Tiles that fit into one tile are joined.
//!
//! Where tiles meet, all levels keep the vertices of the finest one, so there are no cracks between tiles of different
//! levels.
//!
//! ```
//! use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3, mesh::{MeshConfig, Surface}};
//! # let dir = tempfile::tempdir()?;
//! let points = (-20..=20).flat_map(|y| (-20..=20).map(move |z| Vec3::new(1.0, 0.02 * y as f32, 0.02 * z as f32)));
//! let mut map = VoxelMap::new(MapConfig::default())?;
//! Raycast::default().integrate(&mut map, &Scan { points: points.collect(), pose: Some(Pose::IDENTITY), ..Default::default() })?;
//! let mut surface = Surface::new(&map, &MeshConfig::default());
//! let written = tsdfuse_tiles::write(&dir.path().join("wall/tileset.json"), &mut surface)?;
//! assert_eq!(written.tiles, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bounds;
mod compact;
mod error;
mod near;
mod parts;
mod simplify;
mod tile;
mod tileset;
mod write;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub use error::{Result, TilesError};
pub use tile::Coloring;
pub use write::{Written, check, write, write_colored};
