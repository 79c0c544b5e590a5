//! Tests of the device's images of scans against the CPU's: which return each cell or pixel holds.

use tsdfuse::{
    MapConfig, Pose, Scan, SensorModel, VoxelMap,
    fuse::{FuseConfig, Method, twin},
    glam::Vec3,
    scan::PoseAt,
    sensor::{CylindricalProjection, DepthImage, NO_RING, NONE, Pinhole, ScanImage, model},
};

use crate::{DeviceMap, Fused, Fuser, PoolConfig, device::tests::gpu, map::words};

const POOL: PoolConfig = PoolConfig {
    first_blocks: 1 << 15,
    page_blocks: 1 << 15,
    pages: 1,
};

/// The result of a scan, and the contents of a buffer after its kernels.
fn left(scan: &Scan, method: Method, sensor: Option<&SensorModel>, buffer: usize) -> Option<(Fused, Vec<u32>)> {
    let gpu = gpu()?;
    let map = DeviceMap::new(&gpu, MapConfig::default(), POOL).unwrap();
    let mut fuser = Fuser::new(map, method, &FuseConfig::default(), sensor).unwrap();
    // Nothing of the scan before must remain.
    let other = Scan {
        points: scan.points.iter().map(|p| *p * Vec3::new(1.0, -1.0, 1.0)).collect(),
        ..scan.clone()
    };
    fuser.integrate(&other).unwrap();
    fuser.integrate(scan).unwrap();
    let mut done = fuser.finish().unwrap();
    let buffer = &fuser.scratch()[buffer];
    let bytes = gpu.read(buffer, 0, buffer.size()).unwrap();
    Some((done.pop().unwrap(), words(&bytes).collect()))
}

/// Asserts that the returns of a scan are counted as on the CPU.
fn assert_fate(done: &Fused, scan: &Scan, method: Method, sensor: Option<&SensorModel>) {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut integrator = method.build(&FuseConfig::default(), sensor);
    let want = integrator.integrate(&mut map, scan).unwrap();
    assert_eq!((done.fused_returns, done.skipped), (want.fused_returns, want.skipped));
    assert!(want.skipped.hidden > 1000 && want.skipped.outside_image > 3, "{want:?}");
}

/// Asserts that all but a few entries are equal, and that the comparison would detect a shift by one entry.
fn assert_same(want: &[u32], got: &[u32], none: u32, what: &str) {
    let differing = |got: &[u32]| want.iter().zip(got).filter(|(a, b)| a != b).count();
    let filled = want.iter().filter(|entry| **entry != none).count();
    let (all, wrong) = (want.len(), differing(got));
    eprintln!("{what}: {wrong} of {all} differ, {filled} are filled");
    assert!(filled > 1000 && all == got.len() && wrong <= all / 10_000, "{what}");
    assert!(differing(&got[1..]) > filled / 2);
}

/// One turn of a sensor whose rings have different phases; azimuths are rounded down to steps.
fn turn(sensor: &SensorModel, steps: f32) -> Scan {
    let firings = sensor.rings() * sensor.columns as usize;
    let of_firing = |i: usize| {
        let (ring, column) = (i % sensor.rings(), i / sensor.rings());
        let turns = (column as f32 + 0.37 * (ring * ring % 11) as f32) / sensor.columns as f32;
        let azimuth = -std::f32::consts::TAU * (turns * steps).floor() / steps;
        let elevation = sensor.elevations_deg[ring].to_radians();
        let range = 2.0 + (i % 101) as f32 * 0.1;
        let direction = Vec3::new(
            elevation.cos() * azimuth.cos(),
            elevation.cos() * azimuth.sin(),
            elevation.sin(),
        );
        (direction * range, ring as u16)
    };
    let (points, rings) = (0..firings).filter(|i| i % 13 != 2).map(of_firing).unzip();
    Scan {
        points,
        rings: Some(rings),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}

#[test]
fn cells_are_the_cpus() {
    let vlp = model("vlp16").unwrap();
    // As fine as an HDL-64E.
    let fine = SensorModel::from_beams("fine", (-4..4).map(|ring| ring as f32).collect(), 2083, (0.1, 100.0)).unwrap();
    let mut hostile = turn(&vlp, 7000.0);
    hostile.points[3..9].copy_from_slice(&[
        Vec3::NAN,
        Vec3::ZERO,
        Vec3::X * f32::INFINITY,
        Vec3::X * 1e30,
        Vec3::X * 1e-30,
        -Vec3::X,
    ]);
    hostile.rings.as_mut().unwrap()[20..23].copy_from_slice(&[NO_RING, 16, 999]);
    for (name, scan, sensor) in [
        ("exact", turn(&vlp, 1e6), &vlp),
        ("rounded", turn(&fine, 4000.0), &fine),
        ("coarse", turn(&vlp, 500.0), &vlp),
        ("hostile", hostile, &vlp),
    ] {
        let mut image = ScanImage::new();
        image.update(&scan.points, scan.rings.as_deref().unwrap(), sensor);
        let want: Vec<u32> = (0..image.rings()).flat_map(|ring| image.row(ring)).copied().collect();
        let Some((_, words)) = left(&scan, Method::Normals, Some(sensor), 0) else {
            return;
        };
        let got: Vec<u32> = words.into_iter().skip(3).step_by(4).take(want.len()).collect();
        assert_same(&want, &got, NONE, name);
    }
}

/// Adds points in front of a third of the scan's points, behind another third and at the rest; and some invalid ones.
fn crowd(mut scan: Scan) -> Scan {
    let beside = |(i, p): (usize, &Vec3)| *p * [0.5, 1.0, 2.0][i % 3];
    scan.points.extend(scan.points.clone().iter().enumerate().map(beside));
    let nowhere = [Vec3::NAN, Vec3::ZERO, Vec3::Z, Vec3::new(1.0, f32::INFINITY, 0.0)];
    scan.points.splice(100..100, nowhere);
    scan
}

#[test]
fn pixels_of_cylindrical_images_have_the_cpus_returns() {
    let vlp = model("vlp16").unwrap();
    for (name, steps) in [("exact", 1e6), ("rounded", 4000.0), ("coarse", 500.0)] {
        let mut scan = crowd(turn(&vlp, steps));
        scan.rings = None;
        let time = |i: usize| if i % 1000 == 7 { f32::NAN } else { 1e-6 * i as f32 };
        scan.times = Some((0..scan.points.len()).map(time).collect());
        scan.motion = vec![PoseAt {
            pose: Pose {
                translation: tsdfuse::glam::DVec3::X,
                ..Default::default()
            },
            secs: 0.1,
        }];
        let image = twin::cylindrical_image(&vlp, CylindricalProjection::phase_of(&scan.points, vlp.columns));
        let mut want = vec![NONE; image.rows() * image.columns()];
        let depth = |i: u32| image.project(scan.points[i as usize]).depth_m;
        for (i, &p) in (0..).zip(&scan.points) {
            if let Some((row, column)) = image.pixel(image.project(p)) {
                let holder = &mut want[row * image.columns() + column];
                if *holder == NONE || depth(i) < depth(*holder) {
                    *holder = i;
                }
            }
        }
        let Some((done, words)) = left(&scan, Method::Cylindrical, Some(&vlp), 2) else {
            return;
        };
        let got: Vec<u32> = words.iter().skip(want.len()).take(want.len()).map(|i| !i).collect();
        assert_same(&want, &got, NONE, name);
        assert_fate(&done, &scan, Method::Cylindrical, Some(&vlp));
        assert!(done.skipped.outside_grid > 0); // without a time
    }
}

#[test]
fn depths_of_pixels_are_the_cpus() {
    let camera = Pinhole::with_fov(80, 60, 1.1);
    let point = |i: usize| {
        // Beyond the borders, too.
        let (u, v) = (
            (i * 7919 % 9001) as f32 * 0.01 - 5.0,
            (i * 104_729 % 7001) as f32 * 0.01 - 5.0,
        );
        camera.ray(u, v) * (1.0 + (i % 13) as f32 * 0.25)
    };
    let scan = crowd(Scan {
        points: (0..20_000).map(point).collect(),
        pose: Some(Pose::IDENTITY),
        camera: Some(camera),
        ..Default::default()
    });
    let mut image = DepthImage::default();
    image.render(&camera, &scan.points, |p| p);
    let want: Vec<u32> = image.depths_m.iter().map(|depth| depth.to_bits()).collect();
    let Some((done, words)) = left(&scan, Method::Depth, None, 2) else {
        return;
    };
    let depth = |flipped: &u32| if *flipped == 0 { 0 } else { !flipped };
    let got: Vec<u32> = words.iter().take(want.len()).map(depth).collect();
    assert_same(&want, &got, 0, "depths");
    assert_fate(&done, &scan, Method::Depth, None);
}
