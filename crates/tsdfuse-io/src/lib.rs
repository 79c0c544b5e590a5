#![doc = include_str!("../README.md")]

mod argoverse;
pub mod atomic;
mod bin;
mod calib;
mod calibrations;
mod capture;
mod cloud;
pub mod clouds;
pub mod columns;
mod compression;
mod corrected;
mod e57;
pub mod error;
mod feather;
mod files;
mod flatbuffer;
pub mod folder;
#[doc(hidden)]
pub mod fuzzing;
pub mod g2o;
mod geodesy;
pub mod geometry;
pub mod geotiff;
pub mod glb;
mod helipr;
pub mod kitti;
mod kitti360;
pub mod kitti_raw;
mod las;
mod listed;
pub mod log;
pub mod map_file;
pub mod mesh;
mod mounted;
mod mulran;
pub mod nav2;
mod nclt;
mod newer_college;
pub mod npz;
mod nuscenes;
pub mod obj;
pub mod octomap;
mod osf;
pub mod pandaset;
mod pcd;
pub mod photo;
mod pickle;
mod placed;
pub mod plain;
pub mod ply;
pub mod png;
mod point_rows;
pub mod poses;
mod present;
pub mod read_ahead;
mod records;
pub mod rgbd;
pub mod ros;
mod scalar;
mod selection;
pub mod sensor_file;
pub mod source;
mod suggested;
mod text;
pub mod times;
mod together;
mod udp;
#[cfg(feature = "zarr")]
pub mod zarr;

pub use cloud::Cloud;
pub use error::{Error, Result};
pub use log::{Log, open, open_with};
pub use read_ahead::{ReadAhead, ReadScan, Scans};
pub use selection::Selection;
pub use source::{
    GnssFix, ImageRef, ImuSample, Kept, News, OpenOptions, Recorded, ScanRef, Sensor, Source, Stream, StreamedScan,
    Topic,
};
pub use suggested::{
    DEPTH_CAMERA_MAX_RANGE_M, DEPTH_CAMERA_METHOD, DEPTH_CAMERA_TRUNCATION_M, DEPTH_CAMERA_VOXEL_SIZE_M, Suggested,
};
