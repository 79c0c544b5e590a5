//! Real-time dense 3D reconstruction from LiDAR.

pub mod mesh;
pub mod pose;
pub mod scan;
pub mod sensor;

pub use glam;
pub use mesh::Mesh;
pub use pose::Pose;
pub use scan::Scan;
pub use sensor::SensorModel;
