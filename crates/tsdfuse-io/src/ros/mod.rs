//! Recordings of robots: ROS 1 bags, ROS 2 bags (SQLite and MCAP) and other MCAP files, recognised by what is in them.
//!
//! A recording is indexed first; messages are then read one by one, when they are asked for. Its LiDARs' clouds become scans:
//!
//! | what | where from |
//! |---|---|
//! | points | `sensor_msgs/PointCloud2` of any layout, Livox's `CustomMsg`; packets of Velodyne, Hesai and Ouster |
//! | times of points | a field `t`, `time`, `timestamp`, …; unit and reference are inferred over several sweeps |
//! | rings | a field `ring`, `channel`, `line`, …, renumbered from the lowest |
//! | poses | tf, `nav_msgs/Odometry`, `PoseStamped`, `nav_msgs/Path`: those that move and cover the scans; or `--poses` |
//! | places of sensors | static tf; or `--extrinsics` |
//! | IMU, GNSS, images | `sensor_msgs/Imu`, `NavSatFix`, `Image` and `CompressedImage` with `CameraInfo` |
//!
//! Definitions of messages are those in the file; for SQLite bags without them, those of ROS 2. What was concluded is in
//! [`Recorded`](crate::source::Recorded), and `tsdfuse info` shows it.

use std::path::Path;

use crate::error::Result;
use crate::source::OpenOptions;

mod bag;
mod bag1;
mod container;
#[cfg(feature = "db3")]
mod db3;
mod follow;
mod frames;
pub(crate) mod fuzzing;
mod images;
mod lidar;
mod map_messages;
mod mcap;
mod mcap_file;
mod messages;
mod motion;
mod packets;
mod point_times;
mod points;
mod recording;
mod schema;
#[cfg(feature = "serve")]
mod server;
mod sink;
mod survey;
mod told;
mod value;
mod writer;

#[cfg(test)]
mod tests;

pub(crate) use follow::Follow;
pub use map_messages::SurfacePart;
#[cfg(test)]
pub(crate) use mcap::MAGIC as MAGIC_MCAP;
pub(crate) use recording::Recording;
#[cfg(feature = "serve")]
pub use server::Server;
pub use writer::Writer;

/// Whether there is a recording.
pub(crate) fn recognises(path: &Path) -> bool {
    bag::recognises(path)
}

/// Opens a recording: its index, and all poses in it.
pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Recording> {
    Recording::open(path, options)
}
