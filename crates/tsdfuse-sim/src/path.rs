//! Paths of a sensor through a scene: poses `world_from_sensor` at the start of each scan.
//!
//! Positions are rounded to 2⁻²⁰ m, so that they stay exact when a scene is moved to UTM coordinates.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3, EulerRot};
use tsdfuse::Pose;

use crate::scene::Scene;

const NAMES: [&str; 4] = ["vehicle", "drone", "handheld", "orbit"];

/// The names of the paths that [`by_name`] knows.
pub fn names() -> &'static [&'static str] {
    &NAMES
}

/// `scans` poses of a path by its name; `None` for a name that is not in [`names`].
pub fn by_name(name: &str, scene: &Scene, scans: usize) -> Option<Vec<Pose>> {
    match name {
        "vehicle" => Some(vehicle(scene, scans)),
        "drone" => Some(drone(scene, scans)),
        "handheld" => Some(handheld(scene, scans)),
        "orbit" => Some(orbit(scene, scans)),
        _ => None,
    }
}

/// The path that suits the scene: a vehicle in the street, a drone in the hall, an orbit around anything else.
pub fn default_for(scene: &Scene, scans: usize) -> Vec<Pose> {
    match scene.name() {
        "street" => vehicle(scene, scans),
        "hall" => drone(scene, scans),
        _ => orbit(scene, scans),
    }
}

/// A car along x about the middle of the scene, in a gentle S, the sensor 1.9 m above the ground: 1 m from scan to scan, less
/// where the scene is too short. Pitch and roll follow the ground and the car's springs.
pub fn vehicle(scene: &Scene, scans: usize) -> Vec<Pose> {
    const AXLES_M: f64 = 2.6;
    const TRACK_M: f64 = 1.6;
    let lane = |x: f64| 1.3 * (x / 13.0).sin() + 0.3 * (x / 5.0).sin();
    let pose_at = |x: f64| {
        let y = lane(x);
        let yaw = ((lane(x + 0.1) - lane(x - 0.1)) / 0.2).atan();
        let wheel = |ahead: f64, left: f64| {
            let (sin, cos) = yaw.sin_cos();
            ground_m(scene, x + ahead * cos - left * sin, y + ahead * sin + left * cos)
        };
        let (f, r, l) = (AXLES_M / 2.0, -AXLES_M / 2.0, TRACK_M / 2.0);
        let climb = (wheel(f, 0.0) - wheel(r, 0.0)) / AXLES_M;
        let bank = (wheel(0.0, l) - wheel(0.0, -l)) / TRACK_M;
        let pitch = -climb.atan() + 0.006 * (x / 0.9).sin();
        let roll = bank.atan() + 0.008 * (x / 1.4).sin();
        let height = (wheel(f, 0.0) + wheel(r, 0.0)) / 2.0 + 1.9 + 0.02 * (x / 1.1).sin();
        (DVec3::new(x, y, height), [yaw, pitch, roll])
    };
    placed(scene, straight(scene, scans, 1.0).map(pose_at))
}

/// A loop through the air, turning about all axes: at most 0.7 m from scan to scan; more scans than that takes go round once,
/// closer together.
pub fn drone(scene: &Scene, scans: usize) -> Vec<Pose> {
    let half = scene.bounds().max;
    let (rx, ry) = ((0.68 * half.x).min(10.5), (0.42 * half.y).min(4.4));
    // Ramanujan's approximation of the circumference.
    let h = ((rx - ry) / (rx + ry)).powi(2);
    let circumference = TAU / 2.0 * (rx + ry) * (1.0 + 3.0 * h / (10.0 + (4.0 - 3.0 * h).sqrt()));
    let step = TAU * (0.7 / circumference).min(1.0 / scans.max(1) as f64);
    let pose_at = |i: usize| {
        let a = step * i as f64;
        let position = DVec3::new(
            rx * (a + 0.3).cos(),
            ry * (a + 0.3).sin(),
            3.2 + 0.9 * (2.0 * a).sin() + 0.2 * (7.0 * a).sin(),
        );
        let ahead = (ry * (a + 0.3).cos()).atan2(-rx * (a + 0.3).sin());
        let yaw = ahead + 0.4 * (3.0 * a).sin();
        (position, [yaw, 0.15 * (5.0 * a + 0.4).sin(), 0.18 * (4.0 * a).sin()])
    };
    placed(scene, (0..scans).map(pose_at))
}

/// Someone who walks slowly along x about the middle of the scene and looks around: 0.13 m from scan to scan (1.3 m/s at 10 Hz),
/// less where the scene is too short, the sensor 1.5 m above the ground, bobbing and swaying with each step.
pub fn handheld(scene: &Scene, scans: usize) -> Vec<Pose> {
    const STRIDE_M: f64 = 0.75;
    let pose_at = |x: f64| {
        let gait = TAU * x / (2.0 * STRIDE_M);
        let y = 0.35 * (x / 2.3).sin() + 0.03 * gait.sin();
        let z = ground_m(scene, x, y) + 1.5 + 0.025 * (2.0 * gait).sin();
        let yaw = 0.5 * (x / 1.9).sin() + 0.03 * gait.cos();
        let pitch = 0.12 * (x / 1.1).sin() + 0.02 * (2.0 * gait).cos();
        let roll = 0.08 * (x / 0.8).sin() + 0.02 * gait.sin();
        (DVec3::new(x, y, z), [yaw, pitch, roll])
    };
    placed(scene, straight(scene, scans, 0.13).map(pose_at))
}

/// Around the origin, looking at it, once for all scans while rising and sinking: from below too where the scene leaves room.
pub fn orbit(scene: &Scene, scans: usize) -> Vec<Pose> {
    const RADIUS_M: f64 = 6.0;
    let below = scene.offset_m() - DVec3::Z * RADIUS_M;
    // From 20° to 60° above the ground, or to 60° on both sides.
    let (middle, swing) = if scene.signed_distance(below) > 1.0 {
        (0.0, 60.0_f64.to_radians())
    } else {
        (40.0_f64.to_radians(), 20.0_f64.to_radians())
    };
    let pose_at = |i: usize| {
        let a = TAU * i as f64 / scans as f64;
        let elevation = middle + swing * (3.0 * a).sin();
        let outward = DQuat::from_euler(EulerRot::ZYX, a, -elevation, 0.0) * DVec3::X;
        (RADIUS_M * outward, [a + TAU / 2.0, elevation, 0.1 * (2.0 * a).sin()])
    };
    placed(scene, (0..scans).map(pose_at))
}

/// x of scans `spacing` apart or less, about 0 and within four fifths of the scene.
fn straight(scene: &Scene, scans: usize, spacing: f64) -> impl Iterator<Item = f64> {
    let gaps = scans.saturating_sub(1).max(1) as f64;
    let step = spacing.min(1.6 * scene.bounds().max.x / gaps);
    let start = -step * scans.saturating_sub(1) as f64 / 2.0;
    (0..scans).map(move |i| start + step * i as f64)
}

/// Height of what lies below 4.5 m, the clearance over roads; 0 beside the scene.
fn ground_m(scene: &Scene, x: f64, y: f64) -> f64 {
    const CLEARANCE_M: f64 = 4.5;
    let hit = scene.cast_local(DVec3::new(x, y, CLEARANCE_M), -DVec3::Z);
    hit.map_or(0.0, |h| CLEARANCE_M - h.range_m)
}

/// Poses in the world from positions in the scene and yaw, pitch, roll.
fn placed(scene: &Scene, poses: impl Iterator<Item = (DVec3, [f64; 3])>) -> Vec<Pose> {
    const GRID: f64 = (1 << 20) as f64;
    let pose = |(position, [yaw, pitch, roll]): (DVec3, [f64; 3])| Pose {
        rotation: DQuat::from_mat3(&DMat3::from_euler(EulerRot::ZYX, yaw, pitch, roll)).normalize(),
        translation: (position * GRID).round() / GRID + scene.offset_m(),
    };
    poses.map(pose).collect()
}
