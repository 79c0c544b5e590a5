//! What both benches fuse: simulated scans, the same everywhere, with every method.

use anyhow::{Context, Result};
use tsdfuse::fuse::{Distance, FuseConfig, Method, RoldaoForm};
use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::normals::Estimator;
use tsdfuse::scan::RangeLimits;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Integrator, MapConfig, Scan, SensorModel, VoxelMap};
use tsdfuse_io::{DEPTH_CAMERA_MAX_RANGE_M, DEPTH_CAMERA_TRUNCATION_M, DEPTH_CAMERA_VOXEL_SIZE_M};
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

/// The sensor in the street.
const SENSOR: &str = "pandar64";

/// A method with settings of its own.
pub(crate) struct Form {
    pub(crate) name: &'static str,
    method: Method,
    set: fn(&mut FuseConfig),
}

/// All that fuse scan by scan.
pub(crate) const FORMS: [Form; 12] = [
    form("raycast", Method::Raycast, |_| ()),
    form("raycast-projective", Method::Raycast, |config| {
        config.raycast.distance = Distance::Projective;
    }),
    form("normals", Method::Normals, |_| ()),
    form("normals-holz", Method::Normals, |config| {
        config.normals.estimator = Estimator::Holz;
    }),
    form("surfel", Method::Surfels, |_| ()),
    form("surfel-ground-flip", Method::Surfels, |config| {
        config.surfel.ground_flip = true;
    }),
    form("surfel-literal", Method::Surfels, |config| {
        config.surfel.radius_sigmas = 1.0;
    }),
    form("cylindrical", Method::Cylindrical, |_| ()),
    form("kuehner", Method::Kuehner, |_| ()),
    form("depth", Method::Depth, |_| ()),
    form("caminal", Method::Caminal, |_| ()),
    form("roldao-streaming", Method::Roldao, |config| {
        config.roldao.form = RoldaoForm::Streaming;
    }),
];

const fn form(name: &'static str, method: Method, set: fn(&mut FuseConfig)) -> Form {
    Form { name, method, set }
}

impl Form {
    /// Whether it wants images of a depth camera.
    pub(crate) fn wants_depth(&self) -> bool {
        self.method == Method::Depth
    }

    /// An integrator and its empty map: voxels of 5 cm, and 2 cm for the depth camera.
    pub(crate) fn start(&self, sensor: &SensorModel) -> Result<(Box<dyn Integrator>, VoxelMap)> {
        let mut config = FuseConfig::default();
        (self.set)(&mut config);
        let map = if self.wants_depth() {
            MapConfig {
                voxel_size_m: DEPTH_CAMERA_VOXEL_SIZE_M,
                truncation_m: DEPTH_CAMERA_TRUNCATION_M,
                ..Default::default()
            }
        } else {
            MapConfig::default()
        };
        Ok((self.method.build(&config, Some(sensor)), VoxelMap::new(map)?))
    }
}

/// The sensor's model.
pub(crate) fn sensor() -> Result<SensorModel> {
    tsdfuse::sensor::model(SENSOR).context("the sensor is not known")
}

/// Sweeps in the street, a metre apart.
pub(crate) fn street(scans: usize) -> Result<Vec<Scan>> {
    let scene = scene::by_name("street", 0).context("the street cannot be built")?;
    let path = path::default_for(&scene, scans);
    let simulator = Simulator::new(scene, sensor()?, path, SimulatorConfig::default())?;
    let mut scans: Vec<Scan> = simulator.scans().collect();
    scans
        .iter_mut()
        .for_each(|scan| scan.drop_invalid(&RangeLimits::default()));
    Ok(scans)
}

/// What the depth camera looks through.
pub(crate) fn camera() -> Pinhole {
    Pinhole::with_fov(640, 480, 1.0)
}

/// Noise-free images of a depth camera that is carried through the hall.
pub(crate) fn depth_images(scans: usize) -> Result<Vec<Scan>> {
    let scene = scene::by_name("hall", 0).context("the hall cannot be built")?;
    let path = path::by_name("handheld", &scene, scans).context("the path is not known")?;
    let camera = camera();
    let image = |pose: tsdfuse::Pose| {
        let origin = pose.translation;
        let seen = |pixel: u32| -> Option<Vec3> {
            let ray = camera.ray((pixel % camera.width) as f32, (pixel / camera.width) as f32);
            let direction: DVec3 = pose.rotation * ray.as_dvec3();
            let depth_m = scene.cast(origin, direction)?.range_m / direction.length();
            (depth_m <= f64::from(DEPTH_CAMERA_MAX_RANGE_M)).then(|| ray * depth_m as f32)
        };
        Scan {
            points: (0..camera.width * camera.height).filter_map(seen).collect(),
            pose: Some(pose),
            camera: Some(camera),
            ..Default::default()
        }
    };
    Ok(path.into_iter().map(image).collect())
}
