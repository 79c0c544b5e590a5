//! Scans of a box-shaped room for the tests of this crate.

use glam::{DVec3, Vec3};

use super::{Pixel, Projection, SensorModel};

/// Half the room's edges, metres; the sensor is in the middle.
const ROOM_M: DVec3 = DVec3::new(12.0, 7.0, 2.5);

/// The range in a direction (unit vector), metres.
pub(crate) fn range_in_room(direction: DVec3) -> f64 {
    (ROOM_M / direction.abs()).min_element()
}

/// All returns of a full turn, column by column, and the ring of each; every ring fires `phase(ring)` columns late.
pub(crate) fn scan_room(model: &SensorModel, phase: impl Fn(usize) -> f64) -> (Vec<Vec3>, Vec<u16>) {
    let projection = Projection::new(model);
    let firings = (0..model.columns).flat_map(|column| (0..model.rings()).map(move |ring| (column, ring)));
    firings
        .map(|(column, ring)| {
            let direction = projection.direction(Pixel {
                row: ring as f64,
                column: f64::from(column) + phase(ring),
            });
            ((direction * range_in_room(direction)).as_vec3(), ring as u16)
        })
        .unzip()
}

/// The same returns laser by laser, from the top, as KITTI lists them.
pub(crate) fn laser_by_laser(points: &[Vec3], rings: &[u16]) -> (Vec<Vec3>, Vec<u16>) {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(rings[i]));
    order.iter().map(|&i| (points[i], rings[i])).unzip()
}

/// A cheap random number in [0, 1), the same for the same `seed`.
pub(crate) fn random(seed: usize) -> f32 {
    let h = (seed as u32 ^ 0x5bd1_e995).wrapping_mul(0x9E37_79B9);
    let h = (h ^ (h >> 15)).wrapping_mul(0x85EB_CA6B);
    ((h ^ (h >> 13)) >> 8) as f32 / 16_777_216.0
}

/// The folder of real data beside the workspace, if it is there.
pub(crate) fn real_data(folder: &str) -> Option<std::path::PathBuf> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data")
        .join(folder);
    let found = path.is_dir();
    if !found {
        println!("skipped: no real data at {}", path.display());
    }
    found.then_some(path)
}
