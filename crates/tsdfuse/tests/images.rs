//! The methods that fuse images (depth, caminal, cylindrical, kuehner) against their formulas as they stand.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use std::collections::BTreeSet;

use common::{Voxels, assert_agrees, scan};
use tsdfuse::{
    Integrator, MapConfig, Pose, Scan, SensorModel, VoxelMap,
    fuse::{Cylindrical, Depth, Kuehner},
    glam::{DVec3, IVec3, Vec3},
    index::{BlockIndex, voxel_at},
    scan::Motion,
    sensor::Pinhole,
};

/// Half the room in which [`scan`] is.
const ROOM: DVec3 = DVec3::new(3.0, 2.5, 1.5);

/// Where a ray (unit vector, world) from inside the room ends.
fn range(from: DVec3, direction: DVec3) -> f64 {
    ((direction.signum() * ROOM - from) / direction).min_element()
}

const CAMERA: Pinhole = Pinhole {
    width: 72,
    height: 56,
    fx: 50.0,
    fy: 52.0,
    cx: 34.0,
    cy: 29.0,
};

/// A depth image of the room, with a pixel missing here and there.
fn frame(number: usize) -> Scan {
    let room = scan(number, 1);
    let points = (0..CAMERA.pixels()).filter(|i| i % 11 != 3).map(|i| {
        let ray = CAMERA.ray((i % 72) as f32, (i / 72) as f32);
        let in_world = room.pose.rotation * ray.as_dvec3();
        let depth = range(room.pose.translation, in_world);
        ray * (depth + 0.02 * ((i * 7919) % 1000) as f64 / 1000.0) as f32
    });
    Scan {
        points: points.collect(),
        camera: Some(CAMERA),
        ..room
    }
}

/// A band that does not end on a border of blocks, as walls are multiples of their edge away.
fn config() -> MapConfig {
    MapConfig {
        truncation_m: 0.19,
        ..Default::default()
    }
}

fn fuse(method: &mut dyn Integrator, scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(config()).unwrap();
    for scan in scans {
        method.integrate(&mut map, scan).unwrap();
    }
    map
}

/// The blocks within the grid's unit cubes of 8³ voxels that a line from `a` to `b` passes, by testing all in its bounding box.
fn blocks_on(a: DVec3, b: DVec3, edge: f64) -> Vec<BlockIndex> {
    let (lo, hi) = (
        (a.min(b) / edge).floor().as_ivec3(),
        (a.max(b) / edge).floor().as_ivec3(),
    );
    let all =
        (lo.z..=hi.z).flat_map(|z| (lo.y..=hi.y).flat_map(move |y| (lo.x..=hi.x).map(move |x| IVec3::new(x, y, z))));
    let crossed = |block: &IVec3| {
        let (t0, t1) = (
            (block.as_dvec3() * edge - a) / (b - a),
            ((block.as_dvec3() + 1.0) * edge - a) / (b - a),
        );
        t0.min(t1).max_element().max(0.0) < t0.max(t1).min_element().min(1.0)
    };
    all.filter(crossed).map(BlockIndex).collect()
}

/// (5.2) and (5.3) for all voxels of all blocks, after allocation along the lines of sight.
fn literal_depth(frames: &[Scan]) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = config();
    let mut sums = Voxels::new();
    for frame in frames {
        // Blocks that hold something stay.
        let mut blocks: BTreeSet<_> = sums.keys().map(|&v| BlockIndex::of(v.into())).collect();
        let mut image = vec![0.0; CAMERA.pixels()];
        for p in &frame.points {
            let (u, v) = CAMERA.project(*p);
            image[v.round() as usize * 72 + u.round() as usize] = f64::from(p.x);
            let at = |depth: f64| frame.pose.transform_point(p.as_dvec3() * (depth / f64::from(p.x)));
            blocks.extend(blocks_on(at(f64::from(p.x) - mu), at(f64::from(p.x) + mu), 8.0 * k));
        }
        for voxel in blocks
            .iter()
            .flat_map(|&b| (0..512).map(move |local| voxel_at(b, local)))
        {
            let x = frame.pose.inverse().transform_point((voxel.as_dvec3() + 0.5) * k);
            let (u, v) = (34.0 - 50.0 * x.y / x.x, 29.0 - 52.0 * x.z / x.x);
            let (u, v) = (u.round(), v.round());
            if x.x > 0.0 && (0.0..72.0).contains(&u) && (0.0..56.0).contains(&v) {
                let depth = image[v as usize * 72 + u as usize];
                let eta = depth - x.x;
                if depth > 0.0 && eta >= -mu {
                    let sum = sums.entry(voxel.to_array()).or_default();
                    *sum = (sum.0 + 1.0, sum.1 + (eta / mu).min(1.0));
                }
            }
        }
    }
    sums.into_iter().map(|(v, (w, f))| (v, (w, f / w))).collect()
}

#[test]
fn depth_is_what_its_formulas_say() {
    let frames = [frame(0), frame(1), frame(2)];
    let map = fuse(&mut Depth::default(), &frames);
    assert!(map.observed_voxel_count() > 20_000);
    assert_agrees(&map, &literal_depth(&frames), 0.005, "depth");
}

/// A LiDAR with 14 beams at uneven gaps, of which the upper ones sit 3 cm above the lower ones.
fn lidar() -> SensorModel {
    let beams = [
        -31.0, -24.0, -19.0, -15.0, -12.0, -9.5, -7.0, -4.0, -2.0, 0.5, 3.0, 8.0, 14.0, 22.0,
    ];
    SensorModel::from_beams("uneven", beams.to_vec(), 150, (0.1, 30.0)).unwrap()
}

const COLUMNS: usize = 150;

/// A sweep of [`lidar`] in the room, columns turned by a third, every 13th return missing, the sensor moving if `moving`.
fn sweep(number: usize, moving: bool) -> Scan {
    let start = scan(number, 1).pose;
    let end = Pose {
        translation: start.translation + DVec3::new(0.1, -0.05, 0.02),
        ..scan(number + 1, 1).pose
    };
    let motion = moving.then_some(Motion { pose: end, secs: 0.1 });
    let mut sweep = Scan {
        pose: start,
        motion,
        times: moving.then(Vec::new),
        rings: Some(Vec::new()),
        ..Default::default()
    };
    let elevations = lidar().elevations_deg;
    for column in 0..COLUMNS {
        let azimuth = -std::f64::consts::TAU * (column as f64 + 0.33) / COLUMNS as f64;
        let secs = 0.1 * column as f64 / COLUMNS as f64;
        let pose = motion.map_or(start, |motion| tsdfuse::scan::Trajectory::new(start, &motion).at(secs));
        for (ring, elevation) in elevations
            .iter()
            .enumerate()
            .filter(|(ring, _)| (column * 14 + ring) % 13 != 5)
        {
            let (sin, cos) = f64::from(*elevation).to_radians().sin_cos();
            let direction = DVec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
            let from = DVec3::Z * if ring > 6 { 0.03 } else { 0.0 };
            let noise = 0.02 * ((column * 7919 + ring * 104_729) % 1000) as f64 / 1000.0;
            let range = range(pose.transform_point(from), pose.rotation * direction) + noise;
            sweep.points.push((from + direction * range).as_vec3());
            sweep.rings.as_mut().unwrap().push(ring as u16);
            sweep.times.iter_mut().for_each(|times| times.push(secs as f32));
        }
    }
    sweep
}

/// Pixels of [`lidar`]'s image: rows of square pixels from `margin` rows above the highest beam to as many below the lowest.
struct Pixels {
    top: f64,
    rows: usize,
    phase: f64,
    pitch: f64,
    center_z: f64,
}

impl Pixels {
    fn new(margin: usize, phase: f64, center_z: f64) -> Self {
        let pitch = std::f64::consts::TAU / COLUMNS as f64;
        let tan = |degrees: f64| degrees.to_radians().tan();
        let rows = 1 + ((tan(22.0) - tan(-31.0)) / pitch).round() as usize + 2 * margin;
        Self {
            top: tan(22.0) + margin as f64 * pitch,
            rows,
            phase,
            pitch,
            center_z,
        }
    }

    /// Row, column and ρ of a point in the sensor's frame.
    fn of(&self, p: DVec3) -> Option<(usize, usize, f64)> {
        let depth = p.x.hypot(p.y);
        let row = ((self.top - (p.z - self.center_z) / depth) / self.pitch).round();
        let column = (-p.y.atan2(p.x) / self.pitch - self.phase)
            .round()
            .rem_euclid(COLUMNS as f64);
        (row >= 0.0 && row < self.rows as f64).then_some((row as usize, column as usize, depth))
    }

    fn center(&self, row: usize, column: usize, depth: f64) -> DVec3 {
        let azimuth = -(column as f64 + self.phase) * self.pitch;
        DVec3::new(azimuth.cos(), azimuth.sin(), self.top - row as f64 * self.pitch) * depth + DVec3::Z * self.center_z
    }
}

/// The phase that the library finds for a sweep: its returns' mean, of which the bins of its histogram know a 32nd.
fn phase(sweep: &Scan) -> f64 {
    f64::from(tsdfuse::sensor::Cylindrical::phase_of(&sweep.points, COLUMNS as u32))
}

#[test]
fn the_phase_of_a_turn_is_found() {
    assert!((phase(&sweep(0, false)) - 0.33).abs() < 0.02);
}

/// Rounded to pixels, then (5.33), (5.34), (5.7) and (5.8).
fn literal_cylindrical(sweeps: &[Scan]) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = config();
    let mut sums = Voxels::new();
    for sweep in sweeps {
        let pixels = Pixels::new(1, phase(sweep), 0.0);
        let mut image = std::collections::BTreeMap::<(usize, usize), (f64, usize)>::new();
        for (i, p) in sweep.points.iter().enumerate() {
            let (row, column, depth) = pixels.of(p.as_dvec3()).unwrap();
            let holder = image.entry((row, column)).or_insert((depth, i));
            if depth < holder.0 {
                *holder = (depth, i);
            }
        }
        for ((row, column), (depth, i)) in image {
            let trajectory = sweep
                .motion
                .map(|motion| tsdfuse::scan::Trajectory::new(sweep.pose, &motion));
            let pose = trajectory.map_or(sweep.pose, |t| t.at(f64::from(sweep.times.as_ref().unwrap()[i])));
            let (o, p) = (
                pose.translation,
                pose.transform_point(pixels.center(row, column, depth)),
            );
            let center = (p / k).floor().as_ivec3();
            for (z, y, x) in (-6..=6).flat_map(|z| (-6..=6).flat_map(move |y| (-6..=6).map(move |x| (z, y, x)))) {
                let index = center + IVec3::new(x, y, z);
                let v = (index.as_dvec3() + 0.5) * k;
                let off_axis = (o - v).cross(p - o).length() / (p - o).length();
                if (v - p).length() <= mu && off_axis < (3.0 * (k / 2.0).powi(2)).sqrt() {
                    let w = (1.0 / (p - o).length()).min(1.0);
                    let f = (p - v).dot(p - o).signum() * (v - p).length() / mu;
                    let sum = sums.entry(index.to_array()).or_default();
                    *sum = (sum.0 + w, sum.1 + w * f);
                }
            }
        }
    }
    sums.into_iter().map(|(v, (w, f))| (v, (w, f / w))).collect()
}

#[test]
fn cylindrical_is_what_its_formulas_say() {
    for moving in [false, true] {
        let sweeps = [sweep(0, moving), sweep(2, moving)];
        let map = fuse(&mut Cylindrical::new(Some(lidar())), &sweeps);
        assert!(map.observed_voxel_count() > 20_000);
        assert_agrees(&map, &literal_cylindrical(&sweeps), 0.005, "cylindrical");
    }
}

/// The least squares of the distances of a height on the axis to all beams, by trying.
fn literal_center_of_projection(sweep: &Scan) -> f64 {
    let beams = lidar().elevations_deg;
    let squares = |c: f64| -> f64 {
        let of_beam = |(p, ring): (&Vec3, &u16)| {
            let p = p.as_dvec3();
            let (sin, cos) = f64::from(beams[usize::from(*ring)]).to_radians().sin_cos();
            let along = DVec3::new(p.x / p.x.hypot(p.y) * cos, p.y / p.x.hypot(p.y) * cos, sin);
            (DVec3::Z * c - p).cross(along).length_squared()
        };
        sweep
            .points
            .iter()
            .zip(sweep.rings.as_ref().unwrap())
            .map(of_beam)
            .sum()
    };
    let tried = (-2000..2000).map(|i| f64::from(i) * 1e-4);
    tried.min_by(|a, b| squares(*a).total_cmp(&squares(*b))).unwrap()
}

/// Every voxel of the room's surroundings, looked up in the filled image of each sweep.
fn literal_kuehner(sweeps: &[Scan]) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = config();
    let tangents: Vec<f64> = lidar()
        .elevations_deg
        .iter()
        .map(|e| f64::from(*e).to_radians().tan())
        .collect();
    let mut sums = Voxels::new();
    for sweep in sweeps {
        let rings = sweep.rings.as_ref().unwrap();
        let half = |a: usize, b: usize| 0.5 * (tangents[a] - tangents[b]) / (std::f64::consts::TAU / COLUMNS as f64);
        let margin = half(1, 0).max(half(13, 12)).ceil() as usize;
        let pixels = Pixels::new(margin, phase(sweep), literal_center_of_projection(sweep));
        let trajectory = sweep
            .motion
            .map(|motion| tsdfuse::scan::Trajectory::new(sweep.pose, &motion));
        let mut measured = vec![vec![None::<(f64, usize)>; pixels.rows]; COLUMNS];
        for (i, p) in sweep.points.iter().enumerate() {
            let at = trajectory.map_or(sweep.pose, |t| t.at(f64::from(sweep.times.as_ref().unwrap()[i])));
            let p = sweep.pose.inverse().transform_point(at.transform_point(p.as_dvec3()));
            if let Some((row, column, depth)) = pixels.of(p) {
                let pixel = &mut measured[column][row];
                if pixel.is_none_or(|(holder, _)| depth < holder) {
                    *pixel = Some((depth, usize::from(rings[i])));
                }
            }
        }
        let filled = |row: usize, column: usize| {
            let candidates = (0..pixels.rows).filter_map(|other| {
                let (depth, ring) = measured[column][other]?;
                let reach = if row < other {
                    half((ring + 1).min(13), ring.min(12))
                } else {
                    half(ring.max(1), ring.max(1) - 1)
                };
                let distance = row.abs_diff(other);
                (distance == 0 || distance as f64 <= reach).then_some((distance, other, depth))
            });
            candidates
                .min_by_key(|(distance, other, _)| (*distance, *other))
                .map(|(_, _, depth)| depth)
        };
        let (low, high) = ((-(ROOM + 0.4) / k).as_ivec3(), ((ROOM + 0.4) / k).as_ivec3());
        for (z, y, x) in
            (low.z..high.z).flat_map(|z| (low.y..high.y).flat_map(move |y| (low.x..high.x).map(move |x| (z, y, x))))
        {
            let v = sweep
                .pose
                .inverse()
                .transform_point((IVec3::new(x, y, z).as_dvec3() + 0.5) * k);
            let Some((row, column, depth)) = pixels.of(v) else {
                continue;
            };
            let range = (v - DVec3::Z * pixels.center_z).length();
            let Some(pixel) = filled(row, column) else { continue };
            let distance = (pixel - depth) * range / depth;
            if distance.abs() <= mu {
                let w = (1.0 / range).min(1.0);
                let sum = sums.entry([x, y, z]).or_default();
                *sum = (sum.0 + w, sum.1 + w * distance / mu);
            }
        }
    }
    sums.into_iter().map(|(v, (w, f))| (v, (w, f / w))).collect()
}

#[test]
fn kuehner_is_what_its_description_says() {
    for moving in [false, true] {
        let sweeps = [sweep(0, moving), sweep(2, moving)];
        let map = fuse(&mut Kuehner::new(Some(lidar())), &sweeps);
        assert!(map.observed_voxel_count() > 20_000);
        assert_agrees(&map, &literal_kuehner(&sweeps), 0.01, "kuehner");
    }
}
