//! What planners ask of a map.
//!
//! - [`Esdf`]: the Euclidean distance to the nearest surface, for all voxels up to some distance from it. It follows a map
//!   that changes.
//! - [`Occupancy`]: what rays have passed through and where they ended, hence what is free, occupied or unknown.
//! - [`GroundGrid`]: how high, steep and rough the ground is, and whether it can be driven on.
//! - [`Moving`]: which returns of a scan are of things that move.
//!
//! ```
//! use tsdfuse::mesh::{Changes, Incremental};
//! use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::{DVec3, Vec3}};
//! use tsdfuse_plan::{Esdf, EsdfConfig};
//!
//! // A wall at x = 1 m.
//! let points = (-60..=60).flat_map(|y| (-60..=60).map(move |z| Vec3::new(1.0, 0.02 * y as f32, 0.02 * z as f32)));
//! let scan = Scan { points: points.collect(), pose: Some(Pose::IDENTITY), ..Default::default() };
//! let mut map = VoxelMap::new(MapConfig::default())?;
//! let (mut surface, mut changes) = (Incremental::default(), Changes::default());
//! let mut esdf = Esdf::new(EsdfConfig { voxel_size_m: 0.1, radius_m: 2.0 })?;
//! // After each scan:
//! surface.note(&Raycast::default().integrate(&mut map, &scan)?.updated_blocks);
//! surface.changes(&map, &mut changes);
//! esdf.update(changes.iter());
//!
//! let half_way = esdf.sample(DVec3::new(0.5, 0.0, 0.0)).unwrap();
//! assert!((half_way.distance_m - 0.5).abs() < 0.05);
//! assert!(half_way.gradient.x < -0.9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod dense;
mod error;
pub mod esdf;
pub mod ground;
mod marks;
mod moving;
pub mod occupancy;
mod rays;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub use dense::Dense;
pub use error::PlanError;
pub use esdf::{Esdf, EsdfConfig, Nearest};
pub use ground::{GroundConfig, GroundGrid};
pub use moving::{Moving, MovingConfig};
pub use occupancy::{Occupancy, OccupancyConfig};
