//! Maps larger than memory, and maps that outlive a crash.
//!
//! A [`Pager`] keeps in memory the regions of a map that are in use, and the others in a file. Before a scan is fused, it brings what
//! the scan can touch ([`tsdfuse::fuse::Method::reach`]); afterwards it notes what changed, and takes away what was not in use for the longest
//! time. Blocks come back as they went, so that the map is the same, bit for bit, as one that is all in memory.
//!
//! ```text
//!   fusing ─ bring ─▶ regions in memory ◀──────────────── read ahead ─┐
//!      │                  │ what was not in use for long              │
//!      └─ commit ─────────┴────────────────── written behind ─────▶ one thread, one file
//! ```
//!
//! What is on its way to the file is seen by nobody else until it is committed, together with a note of the caller's: which scan was
//! the last. After a crash, at any moment, the file holds what was committed last, all of it and nothing later.
//!
//! ```
//! use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, fuse::{FuseConfig, Method}, glam::Vec3};
//! use tsdfuse_store::{Options, Pager};
//! # let dir = tempfile::tempdir()?;
//! let path = dir.path().join("street.store");
//! let mut map = VoxelMap::new(MapConfig::default())?;
//! let mut pager = Pager::create(&path, &map, b"", Options { limit_bytes: 64 << 20 })?;
//! let scan = Scan { points: vec![Vec3::new(4.0, 0.0, 0.0)], pose: Some(Pose::IDENTITY), ..Default::default() };
//! let reach = Method::Raycast.reach(&FuseConfig::default(), map.config(), &scan)?;
//! pager.bring(&mut map, &reach)?;
//! let done = Raycast::default().integrate(&mut map, &scan)?;
//! pager.note(&map, &done.updated_blocks)?;
//! pager.release(&mut map)?;
//! pager.commit(&mut map, b"one scan")?;
//! # drop(pager);
//! let (map, pager, note) = Pager::open(&path, Options { limit_bytes: 64 << 20 })?;
//! assert_eq!((note.as_slice(), map.integrations()), (&b"one scan"[..], 1));
//! assert_eq!(pager.sizes().blocks, done.updated_blocks.len() as u64);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod file;
mod mesh;
mod pager;
mod surface;
mod weld;
mod worker;

pub use error::{Result, StoreError};
pub use file::{Sizes, recognises, remove_unused};
pub use mesh::Sink;
pub use pager::{Options, Pager};
pub use surface::{CUBE_VOXELS, Surface, is_on_plane};
pub use weld::Weld;
