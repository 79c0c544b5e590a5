//! The methods that fuse images (depth, caminal, cylindrical, kuehner) against their formulas as they stand.

#![allow(clippy::unwrap_used)] // test helpers

mod common;

use std::collections::BTreeSet;

use common::{Voxels, assert_agrees, scan};
use tsdfuse::{
    Integrator, MapConfig, Pose, Scan, SensorModel, VoxelMap,
    fuse::{Caminal, CaminalConfig, Cylindrical, Depth, FuseConfig, Kuehner, KuehnerConfig, Method, RoldaoForm},
    glam::{DVec3, IVec3, Vec3},
    index::{BlockIndex, voxel_at},
    scan::PoseAt,
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
        let in_world = room.pose.unwrap().rotation * ray.as_dvec3();
        let depth = range(room.pose.unwrap().translation, in_world);
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

/// What a camera at a pose sees: depth per pixel, 0 where there is none.
struct Seen {
    camera: Pinhole,
    pose: Pose,
    depths: Vec<f64>,
}

/// (5.2) and (5.3) for all voxels of all blocks, after allocation along the lines of sight; each entry is what one scan sees.
fn literal_depth(scans: &[Vec<Seen>]) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = config();
    let mut sums = Voxels::new();
    for views in scans {
        // Blocks that hold something stay.
        let mut blocks: BTreeSet<_> = sums.keys().map(|&v| BlockIndex::of(v.into())).collect();
        for Seen { camera, pose, depths } in views {
            for (pixel, depth) in depths.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
                let width = camera.width as usize;
                let ray = camera.ray((pixel % width) as f32, (pixel / width) as f32).as_dvec3();
                let at = |depth: f64| pose.transform_point(ray * depth);
                blocks.extend(blocks_on(at(depth - mu), at(depth + mu), 8.0 * k));
            }
        }
        for voxel in blocks
            .iter()
            .flat_map(|&b| (0..512).map(move |local| voxel_at(b, local)))
        {
            for Seen { camera, pose, depths } in views {
                let x = pose.inverse().transform_point((voxel.as_dvec3() + 0.5) * k);
                let (u, v) = camera.project(x.as_vec3());
                let (u, v) = (u.round(), v.round());
                if x.x > 0.0 && u >= 0.0 && v >= 0.0 && u < camera.width as f32 && v < camera.height as f32 {
                    let depth = depths[v as usize * camera.width as usize + u as usize];
                    let eta = depth - x.x;
                    if depth > 0.0 && eta >= -mu {
                        let sum = sums.entry(voxel.to_array()).or_default();
                        *sum = (sum.0 + 1.0, sum.1 + (eta / mu).min(1.0));
                    }
                }
            }
        }
    }
    sums.into_iter().map(|(v, (w, f))| (v, (w, f / w))).collect()
}

/// A frame as its camera saw it.
fn seen(frame: &Scan) -> Vec<Seen> {
    let camera = frame.camera.unwrap();
    let mut depths = vec![0.0; camera.pixels()];
    for p in &frame.points {
        let (u, v) = camera.project(*p);
        depths[v.round() as usize * camera.width as usize + u.round() as usize] = f64::from(p.x);
    }
    vec![Seen {
        camera,
        pose: frame.pose.unwrap(),
        depths,
    }]
}

#[test]
fn depth_is_what_its_formulas_say() {
    let frames = [frame(0), frame(1), frame(2)];
    let map = fuse(&mut Depth::default(), &frames);
    assert!(map.observed_voxel_count() > 20_000);
    assert_agrees(&map, &literal_depth(&frames.each_ref().map(seen)), 0.005, "depth");
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
    let start = scan(number, 1).pose.unwrap();
    let end = Pose {
        translation: start.translation + DVec3::new(0.1, -0.05, 0.02),
        ..scan(number + 1, 1).pose.unwrap()
    };
    let motion = moving.then_some(PoseAt { pose: end, secs: 0.1 });
    let mut sweep = Scan {
        pose: Some(start),
        motion: motion.into_iter().collect(),
        times: moving.then(Vec::new),
        rings: Some(Vec::new()),
        ..Default::default()
    };
    let elevations = lidar().elevations_deg;
    for column in 0..COLUMNS {
        let azimuth = -std::f64::consts::TAU * (column as f64 + 0.33) / COLUMNS as f64;
        let secs = 0.1 * column as f64 / COLUMNS as f64;
        let pose = motion.map_or(start, |motion| tsdfuse::scan::Sweep::new(start, &[motion]).at(secs));
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
    f64::from(tsdfuse::sensor::CylindricalProjection::phase_of(
        &sweep.points,
        COLUMNS as u32,
    ))
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
            let trajectory = sweep.sweep();
            let pose = trajectory.as_ref().map_or(sweep.pose.unwrap(), |t| {
                t.at(f64::from(sweep.times.as_ref().unwrap()[i]))
            });
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

/// The method for [`lidar`].
fn kuehner(max_gap_deg: f32) -> Kuehner {
    Kuehner::new(KuehnerConfig { max_gap_deg }, Some(lidar()))
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
fn literal_kuehner(sweeps: &[Scan], max_gap_deg: f64) -> Voxels {
    let MapConfig {
        voxel_size_m: k,
        truncation_m: mu,
        ..
    } = config();
    let elevations = lidar().elevations_deg;
    let mut sums = Voxels::new();
    for sweep in sweeps {
        let rings = sweep.rings.as_ref().unwrap();
        let half = |above: usize, below: usize| {
            let (above, below) = (f64::from(elevations[above]), f64::from(elevations[below]));
            let share = if above - below > max_gap_deg {
                max_gap_deg / (above - below)
            } else {
                1.0
            };
            let gap = above.to_radians().tan() - below.to_radians().tan();
            share * 0.5 * gap / (std::f64::consts::TAU / COLUMNS as f64)
        };
        let margin = half(1, 0).max(half(13, 12)).ceil() as usize;
        let pixels = Pixels::new(margin, phase(sweep), literal_center_of_projection(sweep));
        let trajectory = sweep.sweep();
        let mut measured = vec![vec![None::<(f64, usize)>; pixels.rows]; COLUMNS];
        for (i, p) in sweep.points.iter().enumerate() {
            let at = trajectory.as_ref().map_or(sweep.pose.unwrap(), |t| {
                t.at(f64::from(sweep.times.as_ref().unwrap()[i]))
            });
            let p = sweep
                .pose
                .unwrap()
                .inverse()
                .transform_point(at.transform_point(p.as_dvec3()));
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
                .unwrap()
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
    for (moving, max_gap_deg) in [(false, 180.0), (true, 180.0), (false, 6.0), (true, 0.0)] {
        let sweeps = [sweep(0, moving), sweep(2, moving)];
        let map = fuse(&mut kuehner(max_gap_deg), &sweeps);
        assert!(map.observed_voxel_count() > 20_000);
        let literal = literal_kuehner(&sweeps, max_gap_deg.into());
        assert_agrees(&map, &literal, 0.01, "kuehner");
    }
}

#[test]
fn kuehner_fills_no_wider_gaps_than_it_is_told() {
    let sweeps = [sweep(0, false)];
    let observed = |max_gap_deg: f32| fuse(&mut kuehner(max_gap_deg), &sweeps).observed_voxel_count();
    // Beams are 2 to 8 degrees apart, columns 2.4.
    let [none, some, all] = [0.0, 4.0, 8.0].map(observed);
    assert!(none < some && some < all, "{none} {some} {all}");
    assert_eq!(all, observed(180.0));
}

#[test]
fn kuehner_refuses_an_image_that_would_fill_memory() {
    let told = |ahead_m: f64| {
        let mut sweep = sweep(0, true);
        let shift = sweep.pose.unwrap().rotation * DVec3::X * ahead_m;
        sweep
            .motion
            .iter_mut()
            .for_each(|motion| motion.pose.translation += shift);
        let mut map = VoxelMap::new(config()).unwrap();
        let done = Kuehner::new(KuehnerConfig::default(), Some(lidar())).integrate(&mut map, &sweep);
        assert_eq!(map.block_count() == 0, done.is_err());
        done.err().map(|e| e.to_string())
    };
    assert_eq!(told(1.0), None);
    let told = told(-1e6).unwrap();
    assert!(told.contains("its motion goes too far within the sweep"), "{told}");
    let wrong = |max_gap_deg| KuehnerConfig { max_gap_deg }.validate().err().map(|e| e.to_string());
    assert_eq!([0.0, 180.0].map(wrong), [None, None]);
    assert!(
        [-1.0, 181.0, f32::NAN]
            .iter()
            .all(|&gap| wrong(gap).unwrap().contains("kuehner.max_gap_deg is"))
    );
}

/// Four cameras of 90° that see all of [`lidar`]'s beams, with pixels as wide as its columns.
fn virtual_camera() -> Pinhole {
    let focal = COLUMNS as f64 / std::f64::consts::TAU;
    let rise = |degrees: f64| focal * degrees.to_radians().tan() * 2_f64.sqrt();
    let edge = |pixels: f64| pixels.ceil() as u32 + 2;
    let width = edge(2.0 * focal);
    Pinhole {
        width,
        height: edge(rise(22.0) + rise(31.0)),
        fx: focal as f32,
        fy: focal as f32,
        cx: 0.5 * (width - 1) as f32,
        cy: rise(22.0).ceil() as f32,
    }
}

/// The mean of the filled pixels in the 3×3 pixels about one.
fn mean_about(image: &[f64], width: i32, pixel: i32) -> f64 {
    let near = (-1..=1).flat_map(|dv| (-1..=1).map(move |du| (pixel / width + dv, pixel % width + du)));
    let inside = near.filter(|&(v, u)| (0..width).contains(&u) && (0..image.len() as i32 / width).contains(&v));
    let filled: Vec<f64> = inside
        .map(|(v, u)| image[(v * width + u) as usize])
        .filter(|d| *d > 0.0)
        .collect();
    filled.iter().sum::<f64>() / (filled.len() as f64).max(1.0)
}

/// Projected, spread for as many rounds as half a hole of 12° has pixels, and smoothed as often.
fn literal_views(sweep: &Scan) -> Vec<Seen> {
    let camera = virtual_camera();
    let rounds = (6_f64.to_radians() * f64::from(camera.fx)).ceil() as usize;
    let trajectory = sweep.sweep();
    let looking = |k: i32| {
        let turned = tsdfuse::glam::DQuat::from_rotation_z(-f64::from(k) * std::f64::consts::FRAC_PI_2);
        let pose = Pose {
            rotation: sweep.pose.unwrap().rotation * turned,
            ..sweep.pose.unwrap()
        };
        let mut depths = vec![0.0; camera.pixels()];
        for (i, p) in sweep.points.iter().enumerate() {
            let at = trajectory.as_ref().map_or(sweep.pose.unwrap(), |t| {
                t.at(f64::from(sweep.times.as_ref().unwrap()[i]))
            });
            let p = pose
                .inverse()
                .transform_point(at.transform_point(p.as_dvec3()))
                .as_vec3();
            let (u, v) = camera.project(p);
            if p.x > 0.0
                && u.round() >= 0.0
                && v.round() >= 0.0
                && u.round() < camera.width as f32
                && v.round() < camera.height as f32
            {
                let depth = &mut depths[v.round() as usize * camera.width as usize + u.round() as usize];
                *depth = if *depth == 0.0 {
                    f64::from(p.x)
                } else {
                    depth.min(f64::from(p.x))
                };
            }
        }
        let measured = depths.clone();
        // In an image with a frame of empty pixels.
        let (width, height) = (camera.width as usize, camera.height as usize);
        let wide = width + 2 * rounds;
        let framed = |pixel: usize| (pixel / width + rounds) * wide + pixel % width + rounds;
        let mut image = vec![0.0; wide * (height + 2 * rounds)];
        (0..depths.len()).for_each(|pixel| image[framed(pixel)] = depths[pixel]);
        let sparse = image.clone();
        for round in 0..2 * rounds {
            let before = image.clone();
            for (pixel, depth) in image.iter_mut().enumerate() {
                let spreads = round < rounds && before[pixel] == 0.0;
                let smooths = round >= rounds && before[pixel] > 0.0 && sparse[pixel] == 0.0;
                if spreads || smooths {
                    *depth = mean_about(&before, wide as i32, pixel as i32);
                }
            }
        }
        (0..depths.len()).for_each(|pixel| depths[pixel] = image[framed(pixel)]);
        // What stays lies in the closing of what was measured.
        let (r, width) = (rounds as i32, width as i32);
        let square = |v: i32, u: i32| (v - r..=v + r).flat_map(move |v| (u - r..=u + r).map(move |u| (v, u)));
        let is_measured = |(v, u): (i32, i32)| {
            (0..width).contains(&u)
                && (0..camera.height as i32).contains(&v)
                && measured[(v * width + u) as usize] > 0.0
        };
        for (pixel, depth) in depths.iter_mut().enumerate().filter(|(_, depth)| **depth > 0.0) {
            let (v, u) = (pixel as i32 / width, pixel as i32 % width);
            if !square(v, u).all(|(v, u)| square(v, u).any(is_measured)) {
                *depth = 0.0;
            }
        }
        assert!(measured.iter().zip(&depths).all(|(m, d)| *m == 0.0 || m == d));
        Seen { camera, pose, depths }
    };
    (0..4).map(looking).collect()
}

#[test]
fn caminal_is_what_its_description_says() {
    for moving in [false, true] {
        let sweeps = [sweep(0, moving), sweep(2, moving)];
        let options = CaminalConfig {
            max_gap_deg: 12.0,
            ..Default::default()
        };
        let map = fuse(&mut Caminal::new(options, Some(lidar())), &sweeps);
        assert!(map.observed_voxel_count() > 20_000);
        assert_agrees(
            &map,
            &literal_depth(&sweeps.each_ref().map(literal_views)),
            0.01,
            "caminal",
        );
    }
}

#[test]
fn maps_of_halves_merge_to_the_map_of_all_unless_a_method_looks_at_what_came_before() {
    let with = |set: fn(&mut FuseConfig)| {
        let mut config = FuseConfig::default();
        set(&mut config);
        config
    };
    let default = FuseConfig::default;
    let methods = [
        (Method::Raycast, default(), true),
        (Method::Normals, default(), true),
        (Method::Surfels, with(|config| config.surfel.finest_cell_m = 0.5), true),
        (Method::Cylindrical, default(), true),
        (Method::Kuehner, default(), true),
        (Method::Patch, with(|config| config.patch.carve = false), true),
        (
            Method::Roldao,
            with(|config| (config.roldao.form, config.roldao.max_level) = (RoldaoForm::Streaming, 8)),
            true,
        ),
        (Method::Roldao, with(|config| config.roldao.max_level = 8), false),
        (Method::Caminal, default(), false),
        (Method::Depth, default(), false),
    ];
    for (method, config, exact) in methods {
        let scans: Vec<Scan> = (0..4)
            .map(|n| {
                if method == Method::Depth {
                    frame(n)
                } else {
                    sweep(n, n % 2 == 1)
                }
            })
            .collect();
        let fused = |scans: &[Scan]| {
            let (mut map, sensor) = (VoxelMap::new(self::config()).unwrap(), lidar());
            let mut integrator = method.build(&config, Some(&sensor));
            scans
                .iter()
                .for_each(|scan| drop(integrator.integrate(&mut map, scan).unwrap()));
            integrator.finish(&mut map).unwrap();
            map
        };
        let (whole, mut half) = (fused(&scans), fused(&scans[..2]));
        assert!(whole != half && half.block_count() > 100, "{method:?}");
        assert_eq!(half.merge(&fused(&scans[2..])), Ok(0));
        assert_eq!(half == whole, exact, "{method:?}");
    }
}

#[test]
fn threads_change_no_bit_of_any_image_method() {
    let sweeps: Vec<_> = (0..3).map(|n| sweep(n, n > 0)).collect();
    let frames: Vec<_> = (0..3).map(frame).collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            [
                fuse(&mut Depth::default(), &frames),
                fuse(&mut Caminal::new(CaminalConfig::default(), Some(lidar())), &sweeps),
                fuse(&mut Cylindrical::new(Some(lidar())), &sweeps),
                fuse(&mut kuehner(180.0), &sweeps),
            ]
        })
    };
    let one = run(1);
    assert!(one.iter().all(|map| map.observed_voxel_count() > 20_000));
    assert!([2, 7].into_iter().all(|threads| run(threads) == one));
    // The comparison sees a scan more.
    assert!(fuse(&mut Depth::default(), &frames[..2]) != one[0]);
}

#[test]
fn scans_that_give_no_image_are_refused_in_one_sentence() {
    let mut map = VoxelMap::new(config()).unwrap();
    let mut refused =
        |method: &mut dyn Integrator, scan: &Scan| method.integrate(&mut map, scan).unwrap_err().to_string();
    let sweep = Scan {
        name: "000007".into(),
        ..sweep(0, false)
    };
    let told = refused(&mut Depth::default(), &sweep);
    assert!(
        told.starts_with("000007: ") && told.contains("depth camera") && told.contains("caminal"),
        "{told}"
    );
    let other = Scan {
        camera: Some(Pinhole { cx: 3.0, ..CAMERA }),
        ..frame(0)
    };
    assert!(refused(&mut Depth::default(), &other).contains("another size"));
    // Points all over, without rings: no beams show.
    let cloud = Scan {
        name: "cloud".into(),
        rings: None,
        times: None,
        ..scan(0, 3000)
    };
    for method in [
        &mut Kuehner::default() as &mut dyn Integrator,
        &mut Cylindrical::default(),
        &mut Caminal::default(),
    ] {
        let told = refused(method, &cloud);
        assert!(
            told.starts_with("cloud: no laser beams show") && told.contains("name the sensor"),
            "{told}"
        );
    }
    assert_eq!(map.block_count(), 0);
}

#[test]
fn lost_rings_are_recovered() {
    let mut with = sweep(0, false);
    // Beams from one point, whose elevations tell them apart.
    let rings = with.rings.as_ref().unwrap();
    (with.points.iter_mut().zip(rings)).for_each(|(p, &ring)| p.z -= if ring > 6 { 0.03 } else { 0.0 });
    let without = Scan {
        rings: None,
        ..with.clone()
    };
    let shuffled = Scan {
        rings: with
            .rings
            .as_ref()
            .map(|rings| rings.iter().map(|ring| 13 - ring).collect()),
        ..with.clone()
    };
    let fuse = |scan: &Scan| fuse(&mut kuehner(180.0), std::slice::from_ref(scan));
    assert!(fuse(&with) == fuse(&without));
    assert!(fuse(&with) != fuse(&shuffled), "rings are of no consequence");
}

#[test]
fn hostile_returns_are_skipped_and_counted() {
    let bad = [
        Vec3::NAN,
        Vec3::ZERO,
        Vec3::new(f32::INFINITY, 0.0, 0.0),
        Vec3::splat(f32::MAX),
        Vec3::splat(-3e9),
        Vec3::Z,
    ];
    let mut sweep = sweep(0, false);
    let good = sweep.points.len();
    sweep.points.extend(bad);
    sweep.rings.as_mut().unwrap().extend([0, 1, 2, 3, 500, u16::MAX]);
    for method in [
        &mut kuehner(180.0) as &mut dyn Integrator,
        &mut Cylindrical::new(Some(lidar())),
        &mut Caminal::new(CaminalConfig::default(), Some(lidar())),
    ] {
        let mut map = VoxelMap::new(config()).unwrap();
        let done = method.integrate(&mut map, &sweep).unwrap();
        let skipped = done.skipped;
        let lost = skipped.outside_grid
            + skipped.without_normal
            + skipped.without_weight
            + skipped.outside_image
            + skipped.hidden;
        assert_eq!(
            done.fused_returns + lost,
            (good + bad.len()) as u64,
            "{method:p}: {done:?}"
        );
        assert!(
            lost >= bad.len() as u64 && done.fused_returns > good as u64 / 2,
            "{skipped:?}"
        );
    }
}
