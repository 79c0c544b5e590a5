//! The plain folder: what the simulator writes, and the simplest thing to bring one's own scans into.
//!
//! ```text
//! velodyne/000000.bin   little-endian f32: x y z intensity of each point, sensor frame, metres
//! poses.txt             optional; per scan 12 numbers: row-major 3×4 world_from_sensor (or TUM: secs x y z qx qy qz qw)
//! times.txt             optional; per scan its time in seconds
//! rings/000000.u16      optional; little-endian u16: the laser of each point, 0 = lowest
//! times/000000.f32      optional; little-endian f32: seconds of each point after the scan's pose
//! motion.txt            optional; per scan "secs" and 12 numbers: where the sensor is secs after the scan's pose, once or
//!                       several times; or "-"
//! sensor.toml           optional; the sensor's model, and body_from_sensor = [12 numbers] if poses are those of a body
//! imu.csv               optional; "t,gx,gy,gz,ax,ay,az", then seconds, rad/s and m/s² of each sample, sensor frame
//! gnss.csv              optional; "t,latitude,longitude,altitude,sigma_east,sigma_north,sigma_up", then seconds, degrees and metres of each fix
//! ```
//!
//! Without `motion.txt`, points with times move towards the next scan's pose (the last scan: away from the one before),
//! which takes `times.txt`. A `calib.txt` with a `Tr` makes the folder a [KITTI](crate::kitti) one.

use std::path::Path;

use crate::error::Result;
use crate::files;
use crate::folder::{self, ScanFolder};
use crate::source::OpenOptions;

mod writer;

pub use writer::{Layout, Writer};

/// Whether there are scans in `velodyne/`.
pub(crate) fn recognises(path: &Path) -> bool {
    files::list(&path.join("velodyne"), "bin").is_ok_and(|files| !files.is_empty())
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let scans = files::list(&path.join("velodyne"), "bin")?;
    let poses = folder::poses(path, options, Path::new(""))?;
    ScanFolder::new("plain folder", path, &scans, poses, options)
}

#[cfg(test)]
mod tests;
