//! An endless street: the scans of one pass through it, again and again, as a log.

use std::sync::Arc;

use tsdfuse::glam::DVec3;
use tsdfuse::{Pose, Scan};
use tsdfuse_io::{Error, ScanRef, Sensor, Source};

use super::street;
use crate::error::Result;

/// Scans of a pass: whole turns of what is done every few scans (carving: 8).
pub(crate) const PASS: usize = 104;

/// The sensor.
pub(crate) const SENSOR: &str = "vlp16";

/// Longer than the street, so that passes do not meet.
const STREET_M: f64 = 125.0;

/// One pass.
pub(crate) struct Street {
    sensor: Sensor,
    poses: Vec<Pose>,
    scans: Vec<Scan>,
}

impl Street {
    pub(crate) fn new() -> Result<Arc<Self>> {
        let simulator = street::simulator(SENSOR, PASS)?;
        Ok(Arc::new(Self {
            sensor: Sensor {
                model: Some(simulator.sensor().clone()),
                ..Sensor::new(SENSOR)
            },
            poses: simulator.path().to_vec(),
            scans: simulator.scans().collect(),
        }))
    }
}

/// Passes one after the other.
pub(crate) struct Drive {
    street: Arc<Street>,
    scans: Vec<ScanRef>,
}

impl Drive {
    /// So many scans for a map with voxels of this size.
    pub(crate) fn new(street: &Arc<Street>, scans: usize, voxel_size_m: f64) -> Self {
        // A region is 64 voxels wide; moved by whole ones, the map's grid meets the street as before.
        let region_m = 64.0 * voxel_size_m;
        let period_m = region_m * (STREET_M / region_m).ceil();
        let scan = |number: usize| {
            let mut pose = street.poses[number % PASS];
            pose.translation += DVec3::X * (number / PASS) as f64 * period_m;
            ScanRef {
                name: number.to_string(),
                sensor: 0,
                time_ns: None,
                pose: Some(pose),
            }
        };
        Self {
            street: street.clone(),
            scans: (0..scans).map(scan).collect(),
        }
    }

    /// The length of the sensor's path, metres.
    pub(crate) fn length_m(&self) -> f64 {
        let places = self.scans.iter().filter_map(|scan| Some(scan.pose?.translation));
        places.clone().zip(places.skip(1)).map(|(a, b)| a.distance(b)).sum()
    }
}

impl Source for Drive {
    fn format(&self) -> &str {
        "simulated"
    }

    fn sensors(&self) -> &[Sensor] {
        std::slice::from_ref(&self.street.sensor)
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> tsdfuse_io::Result<Scan> {
        let reference = self.scans.get(index);
        let reference = reference.ok_or_else(|| Error::dataset("the long drive", format!("has no scan {index}")))?;
        Ok(Scan {
            name: reference.name.clone(),
            pose: reference.pose,
            ..self.street.scans[index % PASS].clone()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of it moves by whole regions, and nothing is seen twice.
    #[test]
    fn the_street_comes_again_elsewhere() {
        let street = Street::new().unwrap();
        for voxel_size_m in [0.1, 0.3] {
            let drive = Drive::new(&street, 250, voxel_size_m);
            let scan = |number| drive.read(number).unwrap();
            let (first, again) = (scan(30), scan(30 + 2 * PASS));
            assert_eq!(first.points, again.points);
            let moved = again.pose.unwrap().translation - first.pose.unwrap().translation;
            let regions = moved.x / 2.0 / (64.0 * voxel_size_m);
            assert!(
                (regions - regions.round()).abs() < 1e-9 && moved.x / 2.0 >= STREET_M,
                "{moved}"
            );
            assert_eq!((moved.y, moved.z), (0.0, 0.0));
            assert!(drive.read(250).is_err());
        }
    }
}
