//! Real-time dense 3D reconstruction from LiDAR.

pub mod fuse;
pub mod index;
pub mod map;
pub mod mesh;
pub mod normals;
pub mod pose;
pub mod scan;
pub mod sensor;

pub use fuse::{Integration, Integrator, Normals, Raycast};
pub use glam;
pub use map::{MapConfig, VoxelMap};
pub use mesh::Mesh;
pub use pose::Pose;
pub use scan::Scan;
pub use sensor::SensorModel;
