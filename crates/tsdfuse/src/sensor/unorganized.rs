//! An image for clouds without beams: Livox and other sensors whose pattern never repeats, merged clouds, depth cameras.

use std::f32::consts::TAU;

use glam::Vec3;

use super::approx::atan2_f32;
use super::{MAX_BEAMS, MAX_COLUMNS, NO_RING, SensorModel};

/// Cells in which directions are counted, to learn how much of the sphere the cloud covers: radians.
const COARSE: f32 = 0.02;

/// Returns for each cell of the image, in the mean.
const PER_CELL: f32 = 1.0;

/// Neighbours in the image are at most this many cells apart: many cells are empty where returns are spread at random.
pub(crate) const NEIGHBOUR_CELLS: usize = 3;

/// The highest row, and the lowest: radians.
const STEEPEST: f32 = 1.57;

/// Cells are at least and at most this wide: radians.
const CELL: (f32, f32) = (0.000_5, 0.05);

/// A grid of elevations and azimuths as fine as a cloud (sensor frame), as the model of a sensor, and the row of each return. Invalid
/// returns have none. `None` for a cloud without any valid return.
pub(crate) fn grid_of(points: &[Vec3]) -> Option<(SensorModel, Vec<u16>)> {
    let elevations: Vec<f32> = points.iter().map(elevation).collect();
    let valid = || points.iter().zip(&elevations).filter(|(_, e)| !e.is_nan());
    let (low, high) = valid().fold((f32::MAX, f32::MIN), |(low, high), (_, &e)| (low.min(e), high.max(e)));
    let count = valid().count();
    if count == 0 {
        return None;
    }
    // The solid angle that is covered.
    let side = |angle: f32| ((angle + TAU) / COARSE) as usize;
    let width = side(TAU) + 1;
    let mut covered = vec![false; width * width];
    for (p, &e) in valid() {
        covered[side(e) * width + side(atan2_f32(p.y, p.x))] = true;
    }
    let rows = covered.chunks(width).enumerate();
    let solid_angle: f32 = rows
        .map(|(row, cells)| {
            let elevation = (row as f32 + 0.5) * COARSE - TAU;
            cells.iter().filter(|c| **c).count() as f32 * elevation.cos().max(0.0) * COARSE * COARSE
        })
        .sum();
    let cell = (PER_CELL * solid_angle / count as f32).sqrt().clamp(CELL.0, CELL.1);
    // Rows within what elevations may be.
    let (low, high) = (low.clamp(-STEEPEST, STEEPEST), high.clamp(-STEEPEST, STEEPEST));
    let gaps = ((high - low) / cell).ceil().min((MAX_BEAMS - 1) as f32);
    let gap = if gaps > 0.0 { (high - low) / gaps } else { cell };
    let elevations_deg = (0..=gaps as usize).map(|k| (low + gap * k as f32).to_degrees());
    let columns = ((TAU / cell) as u32).clamp(4, MAX_COLUMNS);
    let model = SensorModel::from_beams("grid", elevations_deg.collect(), columns, (0.0, f32::MAX)).ok()?;
    let row = |e: &f32| {
        if e.is_nan() {
            NO_RING
        } else {
            ((e.clamp(low, high) - low) / gap + 0.5) as u16
        }
    };
    Some((model, elevations.iter().map(row).collect()))
}

/// NaN for what has no direction.
fn elevation(p: &Vec3) -> f32 {
    let size = p.x.abs() + p.y.abs() + p.z.abs();
    atan2_f32(p.z, (p.x * p.x + p.y * p.y).sqrt()) + 0.0 * size / size
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::ScanImage;

    /// Directions in a cone of 40°, in the order of a sunflower's seeds: no beams, no repetition.
    fn sunflower(count: usize) -> Vec<Vec3> {
        let points = (0..count).map(|i| {
            let x = 1.0 - 0.06 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let across = (1.0 - x * x).sqrt();
            8.0 * Vec3::new(x, across * cos, across * sin)
        });
        points.collect()
    }

    #[test]
    fn most_returns_get_a_cell_and_most_cells_a_return() {
        for count in [2_000, 20_000, 100_000] {
            let points = sunflower(count);
            let (model, rings) = grid_of(&points).unwrap();
            assert_eq!(model.check(), Ok(()));
            let mut image = ScanImage::new();
            image.update(&points, &rings, &model);
            let placed = (0..count).filter(|&i| image.place_of(i).is_some()).count();
            assert!(placed * 10 > count * 6, "{placed} of {count}");
            let is_nearest = |i: usize| {
                let beam = model.elevations_deg[usize::from(rings[i])].to_radians();
                (elevation(&points[i]) - beam).abs() <= 0.51 * TAU / model.columns as f32
            };
            assert!((0..count).all(is_nearest));
        }
    }

    #[test]
    fn hostile_clouds_have_a_small_image_or_none() {
        assert!(grid_of(&[]).is_none());
        assert!(grid_of(&[Vec3::ZERO, Vec3::NAN, Vec3::splat(f32::INFINITY)]).is_none());
        let odd = [Vec3::Z * 1e6, -Vec3::Z, Vec3::X * 1e-6, Vec3::NAN, Vec3::Z * f32::MAX];
        let (model, rings) = grid_of(&odd).unwrap();
        assert_eq!(model.check(), Ok(()));
        assert!(model.rings() * model.columns as usize <= MAX_BEAMS * MAX_COLUMNS as usize);
        assert_eq!(rings[3], NO_RING);
        let again = grid_of(&[Vec3::X; 50]).unwrap();
        assert!(again.1.iter().all(|&r| usize::from(r) < again.0.rings()));
    }
}
