//! What fusing a log wants where its user sets nothing.

use tsdfuse::MapConfig;
use tsdfuse::fuse::Method;
use tsdfuse::scan::RangeLimits;

use crate::source::Sensor;

/// The method for depth cameras.
pub const DEPTH_CAMERA_METHOD: Method = Method::Depth;
/// Voxels for depth cameras, metres.
pub const DEPTH_CAMERA_VOXEL_SIZE_M: f64 = 0.02;
/// Half width of the band around the surface for depth cameras, metres.
pub const DEPTH_CAMERA_TRUNCATION_M: f64 = 0.08;
/// Depth cameras measure badly beyond this, metres.
pub const DEPTH_CAMERA_MAX_RANGE_M: f32 = 5.0;

/// Settings that suit a log's sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suggested {
    /// [`Method::Depth`] for depth cameras.
    pub method: Method,
    /// Voxels and band.
    pub map: MapConfig,
    /// From the nearest range that is not the vehicle itself, where that is known, to the farthest that the sensor measures.
    pub range: RangeLimits,
}

impl Suggested {
    /// What suits these sensors together.
    pub fn of(sensors: &[Sensor]) -> Self {
        let (mut map, mut method) = (MapConfig::default(), Method::default());
        let usual = RangeLimits::default();
        let is_camera = |sensor: &Sensor| sensor.camera.is_some();
        if !sensors.is_empty() && sensors.iter().all(is_camera) {
            method = DEPTH_CAMERA_METHOD;
            map.voxel_size_m = DEPTH_CAMERA_VOXEL_SIZE_M;
            map.truncation_m = DEPTH_CAMERA_TRUNCATION_M;
        }
        let farthest = |sensor: &Sensor| match &sensor.model {
            _ if is_camera(sensor) => DEPTH_CAMERA_MAX_RANGE_M,
            Some(model) => model.max_range_m,
            None => usual.max_range_m,
        };
        let nearest = sensors.iter().filter_map(|sensor| sensor.min_range_m);
        let farthest = sensors.iter().map(farthest);
        Self {
            method,
            map,
            range: RangeLimits {
                min_range_m: nearest.reduce(f32::max).unwrap_or(usual.min_range_m),
                max_range_m: farthest.reduce(f32::max).unwrap_or(usual.max_range_m),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::sensor::Pinhole;

    #[test]
    fn ranges_are_the_logs_and_the_sensors() {
        let range = |sensors: &[Sensor]| {
            let RangeLimits {
                min_range_m,
                max_range_m,
            } = Suggested::of(sensors).range;
            (min_range_m, max_range_m)
        };
        let usual = RangeLimits::default();
        assert_eq!(range(&[]), (usual.min_range_m, usual.max_range_m));
        let model = tsdfuse::sensor::model("vlp16").unwrap();
        let roof = Sensor {
            min_range_m: Some(2.5),
            model: Some(model.clone()),
            ..Sensor::new("roof")
        };
        assert_eq!(range(std::slice::from_ref(&roof)), (2.5, model.max_range_m));
        // Of several sensors, what one of them measures is kept, and what is a vehicle to one of them is not.
        assert_eq!(range(&[Sensor::new("front"), roof]), (2.5, usual.max_range_m));
    }

    #[test]
    fn depth_cameras_get_their_own_method_and_voxels() {
        let camera = Sensor {
            camera: Some(Pinhole::with_fov(80, 60, 1.1)),
            min_range_m: Some(0.1),
            ..Sensor::new("camera")
        };
        let Suggested { method, map, range } = Suggested::of(std::slice::from_ref(&camera));
        assert_eq!(
            (method, map.voxel_size_m, map.truncation_m),
            (Method::Depth, 0.02, 0.08)
        );
        assert_eq!((range.min_range_m, range.max_range_m), (0.1, 5.0));
        let mixed = Suggested::of(&[camera, Sensor::new("lidar")]);
        assert_eq!((mixed.method, mixed.map), (Method::default(), MapConfig::default()));
        assert_eq!(mixed.range.max_range_m, RangeLimits::default().max_range_m);
    }
}
