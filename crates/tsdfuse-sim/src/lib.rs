//! Simulated LiDAR sequences in analytic scenes whose exact signed distance is known.
//!
//! A [`Scene`] is a union of [`Primitive`]s. It answers three questions exactly: how far the surface is
//! ([`Scene::signed_distance`]), what a ray hits ([`Scene::cast`]), and what the true mesh is ([`Scene::mesh`]). A [`Simulator`] moves a rotating sensor through it along a [`path`] and yields
//! [`tsdfuse::Scan`]s with the sensor's errors ([`NoiseModel`]).
//!
//! All lengths are metres, angles radians; z points up, and the sensor's x axis forward.
//!
//! ```
//! use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};
//!
//! let scene = scene::by_name("sphere", 0).unwrap();
//! let sensor = tsdfuse::sensor::model("vlp16").unwrap();
//! let path = path::by_name("orbit", &scene, 3).unwrap();
//! let config = SimulatorConfig { noise: NoiseModel::none(), ..Default::default() };
//! let simulator = Simulator::new(scene, sensor, path, config).unwrap();
//! for scan in simulator.scans() {
//!     for point_in_world in scan.points_in_world()? {
//!         assert!(simulator.scene().signed_distance(point_in_world).abs() < 1e-5);
//!     }
//! }
//! # Ok::<(), tsdfuse::scan::ScanError>(())
//! ```

mod beam;
mod bvh;
mod hits;
mod lidar;
mod noise;
mod objects;
pub mod path;
mod primitive;
pub mod scene;

pub use hits::Hits;
pub use lidar::{SimulationError, Simulator, SimulatorConfig};
pub use noise::NoiseModel;
pub use primitive::{Primitive, Terrain};
pub use scene::{Hit, Scene};
pub use tsdfuse::Pose;

/// Compiles the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
