//! The returns of a sweep: from columns in world coordinates to points as the sensor saw them.

use tsdfuse::Scan;
use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::scan::{Dropped, PoseAt, Sweep};

use super::calibration::Lidar;
use super::motion::{self, Placement};
use crate::pickle::DataFrame;

/// Returns farther than this from their frame's time were not measured in its sweep.
const MAX_TIME_OFFSET_SECS: f64 = 0.3;

/// The columns of a sweep's table, with the returns of both sensors.
pub(super) struct Returns {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    intensity: Vec<f64>,
    device: Vec<f64>,
    /// Seconds after the frame's time; empty where they do not matter, because the motion is not known.
    secs: Vec<f64>,
}

impl Returns {
    /// Reads the columns.
    ///
    /// # Errors
    /// Names the column that is missing or holds no numbers.
    pub(super) fn new(table: &DataFrame<'_>, sweep: &Placement) -> Result<Self, String> {
        let mut secs = Vec::new();
        if let (Some(_), Some(end)) = (sweep.motion, sweep.secs) {
            secs = table.column("t")?;
            secs.iter_mut().for_each(|t| *t -= end);
        }
        Ok(Self {
            x: table.column("x")?,
            y: table.column("y")?,
            z: table.column("z")?,
            intensity: table.column("i")?,
            device: table.column("d")?,
            secs,
        })
    }

    /// What one sensor measured, in its own frame at the time of each return.
    ///
    /// # Errors
    /// Most returns have no time within the sweep.
    pub(super) fn measured(&self, sensor: Lidar, sweep: &Placement) -> Result<Scan, String> {
        let mine = self.of(sensor);
        let mut scan = Scan {
            intensities: Some(mine.iter().map(|&k| self.intensity[k] as f32).collect()),
            dropped: Dropped {
                other_sensor: (self.device.len() - mine.len()) as u64,
                ..Dropped::default()
            },
            ..Scan::default()
        };
        let Some(motion) = sweep.motion else {
            let sensor_from_world = sweep.pose.inverse();
            let place = |&k| sensor_from_world.transform_point(self.point_in_world(k)).as_vec3();
            scan.points = mine.iter().map(place).collect();
            return Ok(scan);
        };

        // Rounded, as whoever places the point again will have it.
        let times: Vec<Option<f32>> = mine.iter().map(|&k| Some(self.secs(k)? as f32)).collect();
        let untimed = times.iter().filter(|time| time.is_none()).count();
        if 2 * untimed > mine.len() {
            return Err(format!(
                "column 't': {untimed} of {} times are not within {MAX_TIME_OFFSET_SECS} s of the frame's, {:.6}",
                mine.len(),
                sweep.secs.unwrap_or_default()
            ));
        }
        let motion = self.refined(motion, sensor, sweep);
        let trajectory = Sweep::new(sweep.pose, &[motion]);
        let place = |(&k, time): (&usize, &Option<f32>)| match *time {
            None => Vec3::NAN,
            Some(time) => {
                let world_from_sensor = trajectory.at(time.into());
                let shift = self.point_in_world(k) - world_from_sensor.translation;
                (world_from_sensor.rotation.conjugate() * shift).as_vec3()
            }
        };
        scan.points = mine.iter().zip(&times).map(place).collect();
        scan.times = Some(times.into_iter().map(|time| time.unwrap_or(f32::NAN)).collect());
        scan.motion = vec![motion];
        Ok(scan)
    }

    /// The motion of a sensor, from what the beams of the Pandar64 tell about the vehicle's.
    fn refined(&self, motion: PoseAt, sensor: Lidar, sweep: &Placement) -> PoseAt {
        let Some(model) = Lidar::Pandar64.model() else {
            return motion;
        };
        let sensor_from_pandar64 = sensor.ego_from_sensor().inverse() * Lidar::Pandar64.ego_from_sensor();
        let of_pandar64 = PoseAt {
            pose: motion.pose * sensor_from_pandar64,
            ..motion
        };
        let world_from_pandar64 = sweep.pose * sensor_from_pandar64;
        let pandar64_from_world = world_from_pandar64.inverse();
        let timed = self.of(Lidar::Pandar64).into_iter().filter_map(|k| {
            Some(motion::Return {
                point: pandar64_from_world.transform_point(self.point_in_world(k)),
                secs: self.secs(k)?,
            })
        });
        let refined = motion::refine(of_pandar64, world_from_pandar64, &model, &timed.collect::<Vec<_>>());
        PoseAt {
            pose: refined.pose * sensor_from_pandar64.inverse(),
            ..motion
        }
    }

    /// Which returns a sensor measured.
    fn of(&self, sensor: Lidar) -> Vec<usize> {
        let device = sensor.device();
        (0..self.device.len()).filter(|&k| self.device[k] == device).collect()
    }

    fn point_in_world(&self, k: usize) -> DVec3 {
        DVec3::new(self.x[k], self.y[k], self.z[k])
    }

    /// When a return was measured, seconds after the frame's time, if that can be.
    fn secs(&self, k: usize) -> Option<f64> {
        self.secs.get(k).copied().filter(|t| t.abs() <= MAX_TIME_OFFSET_SECS)
    }
}
