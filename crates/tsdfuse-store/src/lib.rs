//! Maps larger than memory, and maps that outlive a crash.
//!
//! A [`PagedMap`] keeps the regions that are in use in memory, and all others in a file. Before a scan is fused, it
//! loads the regions that the scan can touch; afterwards it evicts the least recently used regions if memory use
//! exceeds the limit. The map is the same, bit for bit, as one in memory.
//!
//! ```text
//!   integrate ── load ──▶ regions in memory ◀──────────────── prefetch ─┐
//!      │                      │ least recently used: evict              │
//!      └─ commit ─────────────┴─────────────── written behind ─────▶ one thread, one file
//! ```
//!
//! Regions that are written take effect with the next commit, which also stores a checkpoint: bytes of the caller, such
//! as the number of the last scan. After a crash at any moment, the file holds the last commit: all of it, and nothing
//! later.
//!
//! ```
//! use tsdfuse::{MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3};
//! use tsdfuse_store::PagedMap;
//! # let dir = tempfile::tempdir()?;
//! # let path = dir.path().join("street.store");
//! # let scan = Scan { points: vec![Vec3::new(4.0, 0.0, 0.0)], pose: Some(Pose::IDENTITY), ..Default::default() };
//! let mut map = PagedMap::create(&path, VoxelMap::new(MapConfig::default())?, b"", Some(64 << 20))?;
//! let done = map.integrate(&mut Raycast::default(), &scan)?;
//! map.commit(b"one scan")?;
//! # drop(map);
//! let (map, checkpoint) = PagedMap::open(&path, Some(64 << 20))?;
//! assert_eq!((checkpoint.as_slice(), map.integrations()), (&b"one scan"[..], 1));
//! assert_eq!(map.sizes().blocks, done.updated_blocks.len() as u64);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! All bytes of the file are covered by checksums: a damaged store is an error that names the file, and [`Salvage`]
//! recovers what is intact.

mod disk;
mod error;
mod file;
mod format;
#[doc(hidden)]
pub mod fuzzing;
mod paged_map;
mod pager;
mod salvage;
mod space;
mod worker;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub use error::{PagedError, Result, StoreError};
pub use file::{recognises, remove_unused};
pub use format::Sizes;
pub use paged_map::{OverLimit, PagedMap};
pub use salvage::{Damage, Salvage};
