//! tsdfuse on any GPU: scans fused, meshes extracted and views rendered by compute shaders, through wgpu (Vulkan, Metal,
//! DirectX 12).
//!
//! ```
//! use tsdfuse::{MapConfig, Scan, fuse::Method, glam::Vec3};
//! use tsdfuse_gpu::{DeviceMap, Fuser, Gpu, Mesher};
//!
//! let Ok(gpu) = Gpu::open(None) else { return Ok(()) }; // there is none
//! let map = DeviceMap::new(&gpu, MapConfig::default(), Default::default())?;
//! let mut fuser = Fuser::new(map, Method::Raycast, &Default::default(), None)?;
//! # let points = (-20..=20).flat_map(|y| (-20..=20).map(move |z| Vec3::new(1.0, 0.02 * y as f32, 0.02 * z as f32)));
//! # let scans = [Scan { points: points.collect(), pose: Some(Default::default()), ..Default::default() }];
//!
//! for scan in &scans {
//!     for done in fuser.integrate(scan)? {
//!         println!("{}: {} returns", done.name, done.fused_returns); // a scan submitted a few calls ago
//!     }
//! }
//! let map = fuser.into_map()?; // waits
//! let mesh = Mesher::new(&map)?.extract(&map, &Default::default())?;
//! assert!(mesh.vertices.iter().all(|v| (v.x - 1.0).abs() < 0.03));
//! let map = map.download()?; // a `VoxelMap`, to be saved or to go on with on the CPU
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The main types: [`Gpu`], [`DeviceMap`] (the map on the device; conversion from and to a [`VoxelMap`](tsdfuse::VoxelMap) is
//! exact), [`Fuser`], [`Mesher`], [`Renderer`].
//!
//! **Results are deterministic** on one device: sums are integers, so neither the scheduling of the scans nor the growth of the
//! map changes a bit. Between devices, and between a device and the CPU, a few voxels in a hundred thousand differ, since
//! shader compilers may reorder floating-point operations; `docs/gpu.md` has figures.
//!
//! **Nothing is lost.** When the map is full, it grows, and the scans in flight are repeated. When the device is full, an error
//! says so, and its map still holds the scans reported before.
//!
//! **A copy can follow.** Each scan reports the blocks that it updated ([`Fused::updated_blocks`]), and
//! [`DeviceMap::download_blocks`] fetches chosen blocks.

mod constants;
#[cfg(test)]
mod contract;
mod device;
mod error;
mod flight;
mod frame;
mod fuser;
mod gather;
#[cfg(test)]
mod image;
mod kernels;
mod map;
mod mesh;
mod method;
mod prepared;
mod render;
mod scratch;
mod shader;
mod surface;
mod sweep;
mod timeline;

pub use device::{Gpu, quiet_variable};
pub use error::GpuError;
pub use fuser::{Fused, Fuser};
pub use map::{DeviceMap, PoolConfig};
pub use mesh::Mesher;
pub use method::METHODS;
pub use render::Renderer;
pub use timeline::Stage;

/// Compiles the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
