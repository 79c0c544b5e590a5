//! The device's organized images, against the CPU's.

use tsdfuse::{
    MapConfig, Scan, SensorModel,
    fuse::{FuseConfig, Method},
    glam::Vec3,
    sensor::{NO_RING, NONE, ScanImage, model},
};

use crate::{DeviceMap, Fuser, PoolConfig, device::tests::gpu, map::words, prepared::CELL_BYTES};

const POOL: PoolConfig = PoolConfig {
    first_blocks: 1 << 15,
    page_blocks: 1 << 15,
    pages: 1,
};

/// The return in each cell, on the CPU and on the device.
fn cells(scan: &Scan, sensor: &SensorModel) -> Option<[Vec<u32>; 2]> {
    let gpu = gpu()?;
    let mut image = ScanImage::new();
    image.update(&scan.points, scan.rings.as_deref().unwrap(), sensor);
    let want: Vec<u32> = (0..image.rings()).flat_map(|ring| image.row(ring)).copied().collect();
    let map = DeviceMap::new(&gpu, MapConfig::default(), POOL).unwrap();
    let mut fuser = Fuser::new(map, Method::Normals, &FuseConfig::default(), Some(sensor)).unwrap();
    // Nothing is left of the scan before.
    let other = Scan {
        points: scan.points.iter().map(|p| *p * Vec3::new(1.0, -1.0, 1.0)).collect(),
        ..scan.clone()
    };
    fuser.integrate(&other).unwrap();
    fuser.integrate(scan).unwrap();
    fuser.finish().unwrap();
    let bytes = gpu
        .read(&fuser.scratch()[0], 0, CELL_BYTES * want.len() as u64)
        .unwrap();
    Some([want, words(&bytes).skip(3).step_by(4).collect()])
}

/// A turn of a sensor whose rings have phases of their own; azimuths are rounded down to steps.
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
        let Some([want, got]) = cells(&scan, sensor) else {
            return;
        };
        let filled = want.iter().filter(|i| **i != NONE).count();
        let differing = want.iter().zip(&got).filter(|(a, b)| a != b).count();
        eprintln!(
            "{name}: {differing} of {} cells differ, {filled} are filled",
            want.len()
        );
        assert!(filled > want.len() / 4 && want.len() == got.len());
        assert!(differing <= want.len() / 10_000, "{name}");
        // A turn by one column shows.
        let turned = want.iter().zip(got.iter().skip(1));
        assert!(turned.filter(|(a, b)| a != b).count() > filled / 2);
    }
}
