//! What each method is bad at, after thesis 7.3 to 7.6: the situation is built, what goes wrong is measured, and so is what does
//! not go wrong without it. (7.5, surfels, is a test of the core.)

#![allow(clippy::unwrap_used)] // test helpers

mod edges;
mod grazing;
mod on_the_floor;
mod rounding;

use tsdfuse::{
    MapConfig, Mesh, Pose, Scan, SensorModel, VoxelMap,
    fuse::{FuseConfig, Integration, Method},
    glam::{DQuat, DVec3, EulerRot, Vec3},
};
use tsdfuse_sim::{NoiseModel, Primitive, Scene, Simulator, SimulatorConfig};

/// A sensor that goes through a scene; its ranges have an error of `sigma_m`, nothing else is wrong.
fn simulator(solids: Vec<Primitive>, sensor: SensorModel, path: Vec<Pose>, sigma_m: f64) -> Simulator {
    let config = SimulatorConfig {
        noise: NoiseModel {
            range_sigma_m: sigma_m,
            ..NoiseModel::none()
        },
        ..Default::default()
    };
    Simulator::new(Scene::new("drawback", solids), sensor, path, config).unwrap()
}

fn turned(translation: DVec3, yaw: f64, pitch: f64, roll: f64) -> Pose {
    Pose {
        rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
        translation,
    }
}

/// Ground up to z = 0, and far to all sides.
fn ground() -> Primitive {
    Primitive::cuboid(DVec3::new(200.0, 60.0, 1.0)).at(0.0, 0.0, -0.5)
}

/// The returns that hit what lies there, as the other ones are far enough away not to matter.
fn only(mut scan: Scan, there: impl Fn(DVec3) -> bool) -> Scan {
    let in_world = |p: &Vec3| scan.pose.unwrap().transform_point(p.as_dvec3());
    let keep: Vec<bool> = scan.points.iter().map(|p| there(in_world(p))).collect();
    scan.keep_only(&keep);
    scan
}

/// Fuses scans with a method's default options.
fn fuse(method: Method, sensor: &SensorModel, scans: &[Scan]) -> (VoxelMap, Vec<Integration>) {
    let mut integrator = method.build(&FuseConfig::default(), Some(sensor));
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let done = scans
        .iter()
        .map(|s| integrator.integrate(&mut map, s).unwrap())
        .collect();
    (map, done)
}

/// Centre of each triangle, and its area as a vector towards free space.
fn triangles(mesh: &Mesh) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
    mesh.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
        ((a + b + c) / 3.0, (b - a).cross(c - a) / 2.0)
    })
}
