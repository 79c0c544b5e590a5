//! Which points share a cell. They are sorted by cell, then by number, so that every sum over a cell is in the scan's order.

use glam::Vec3;
use rayon::prelude::*;

use super::config::SurfelConfig;

/// The number of a point, and its cell. Ordered by cell, then by point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Cell {
    pub(super) key: Key,
    pub(super) point: u32,
}

/// Level (4 bits), then z, y, x (20 bits each, the sensor in the middle), highest first.
type Key = u64;

/// Half the cells along an axis.
const HALF: i32 = 1 << 19;

/// The cell of a point; `None` where there is none.
#[inline]
fn key(point: Vec3, config: &SurfelConfig) -> Option<Key> {
    let level = config.level(point.length_squared());
    let cell = (point / config.cell_m(level)).floor();
    // Also false for NaN.
    if !cell.abs().cmplt(Vec3::splat(HALF as f32)).all() {
        return None;
    }
    let c = (cell.as_ivec3() + HALF).as_u64vec3();
    Some(u64::from(level) << 60 | c.z << 40 | c.y << 20 | c.x)
}

/// Sorts the points that have a cell into `cells`. Returns how many have none.
pub(super) fn sort(points: &[Vec3], config: &SurfelConfig, cells: &mut Vec<Cell>) -> u64 {
    // No cell has this key: levels end below 15.
    const NONE: Key = Key::MAX;
    let numbered = points.par_iter().enumerate().map(|(point, &at)| Cell {
        key: key(at, config).unwrap_or(NONE),
        point: point as u32,
    });
    numbered.collect_into_vec(cells);
    cells.par_sort_unstable();
    let inside = cells.partition_point(|cell| cell.key != NONE);
    let outside = cells.len() - inside;
    cells.truncate(inside);
    outside as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_ends_at_its_range_and_the_last_never() {
        let config = SurfelConfig {
            finest_range_m: 8.0,
            levels: 3,
            ..Default::default()
        };
        let level = |distance: f32| config.level(distance * distance);
        let levels = [0.0, 7.9, 8.0, 8.001, 16.0, 16.001, 32.0, 33.0, 1e6].map(level);
        assert_eq!(levels, [0, 0, 0, 1, 1, 2, 2, 2, 2]);
        assert_eq!([0, 1, 2].map(|l| config.cell_m(l)), [0.25, 0.5, 1.0]);
    }

    #[test]
    fn points_share_a_cell_if_level_and_place_are_the_same() {
        let config = SurfelConfig {
            finest_cell_m: 1.0,
            finest_range_m: 4.0,
            levels: 2,
            ..Default::default()
        };
        let points = [
            Vec3::new(0.5, -0.5, 0.5),
            Vec3::new(f32::NAN, 0.0, 0.0),
            Vec3::new(4.5, 0.5, 0.5),
            Vec3::new(0.1, -0.9, 0.9),
            Vec3::new(-0.1, -0.5, 0.5), // the cell beside it
            Vec3::new(0.0, 0.0, 1e9),
            Vec3::new(0.0, f32::NAN, 0.0),
            Vec3::new(0.0, 0.0, f32::NAN),
            Vec3::new(5.9, 1.9, 0.1),
            Vec3::new(3.9, 0.5, 0.5), // the cell of point 2, if it were on its level
        ];
        let mut cells = Vec::new();
        assert_eq!(sort(&points, &config, &mut cells), 4);
        let groups: Vec<Vec<u32>> = cells
            .chunk_by(|a, b| a.key == b.key)
            .map(|group| group.iter().map(|cell| cell.point).collect())
            .collect();
        assert_eq!(groups, [vec![4], vec![0, 3], vec![9], vec![2, 8]]);
    }
}
