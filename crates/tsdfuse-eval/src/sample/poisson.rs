//! Poisson-disk samples by sample elimination: Yuksel, "Sample Elimination for Generating Poisson Disk Sample Sets",
//! Computer Graphics Forum 34(2), 2015.

mod grid;
mod queue;

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use super::area::ByArea;
use grid::Grid;
use queue::Queue;

/// Candidates per sample (section 4: more hardly improve the result).
const CANDIDATES: usize = 5;
/// Parameters of the weight function (section 3).
const ALPHA: i32 = 8;
const BETA: f64 = 0.65;
const GAMMA: f64 = 1.5;
/// The largest term of a weight. Weights are sums of integers, so that the order of additions does not matter.
const UNIT: f64 = 1_048_576.0;

/// `count` points of a mesh, no two of them near each other: of five times as many uniform samples, those with the most near
/// neighbours are eliminated one after another. Empty for a mesh without area.
pub fn poisson_disk(mesh: &Mesh, count: usize) -> Vec<DVec3> {
    let area = ByArea::of(mesh);
    let candidates = CANDIDATES * count;
    if count == 0 || !(area.total_m2() > 0.0) {
        return Vec::new();
    }
    let kernel = Kernel::new(area.total_m2(), count);
    // Relative to the first one, so that f32 is precise enough for weights.
    let origin = area.point(0, candidates).unwrap_or_default();
    let relative = |i| area.point(i, candidates).map_or(Vec3::ZERO, |p| (p - origin).as_vec3());
    let positions: Vec<Vec3> = (0..candidates).into_par_iter().map(relative).collect();
    let kept = eliminate(positions, count, &kernel);
    kept.into_par_iter()
        .filter_map(|i| area.point(i as usize, candidates))
        .collect()
}

/// The weight of two samples on each other.
struct Kernel {
    /// Twice the largest radius that `count` disks on this area can have.
    reach_m: f32,
    /// Twice the smallest radius that makes a difference.
    least_m: f32,
    /// Scales the largest weight to [`UNIT`].
    scale: f32,
}

impl Kernel {
    fn new(area_m2: f64, count: usize) -> Self {
        // Equation 3: the radius of disks in the densest packing of the plane.
        let r_max = (area_m2 / (2.0 * 3_f64.sqrt() * count as f64)).sqrt();
        // Equation 5, with N / M = 1 / CANDIDATES.
        let r_min = r_max * (1.0 - (1.0 / CANDIDATES as f64).powf(GAMMA)) * BETA;
        Self {
            reach_m: (2.0 * r_max) as f32,
            least_m: (2.0 * r_min) as f32,
            scale: (UNIT / (1.0 - r_min / r_max).powi(ALPHA)) as f32,
        }
    }

    /// Equations 2 and 4, rounded; 0 from `reach_m` on.
    fn weight(&self, a: Vec3, b: Vec3) -> u64 {
        let squared = a.distance_squared(b);
        if squared >= self.reach_m * self.reach_m {
            return 0;
        }
        let limited = squared.sqrt().max(self.least_m);
        (self.scale * (1.0 - limited / self.reach_m).powi(ALPHA)).round() as u64
    }
}

/// Eliminates all but `count` samples: each time the one with the largest weight, the last one among equals. Returns the numbers
/// of the remaining samples, in order.
fn eliminate(positions: Vec<Vec3>, count: usize, kernel: &Kernel) -> Vec<u32> {
    let grid = Grid::new(positions, kernel.reach_m);
    let mut weights: Vec<u64> = (0..grid.positions.len())
        .into_par_iter()
        .map(|i| {
            let others = grid.around(i).filter(|&j| j != i);
            others
                .map(|j| kernel.weight(grid.positions[i], grid.positions[j]))
                .sum()
        })
        .collect();
    let mut alive = vec![true; weights.len()];
    let mut queue = Queue::new(&weights);
    for _ in count..weights.len() {
        let Some(heaviest) = queue.pop(&weights, &grid.numbers) else {
            break;
        };
        alive[heaviest] = false;
        for j in grid.around(heaviest).filter(|&j| alive[j]) {
            weights[j] -= kernel.weight(grid.positions[heaviest], grid.positions[j]);
        }
    }
    let mut kept: Vec<u32> = grid
        .numbers
        .iter()
        .zip(alive)
        .filter_map(|(&n, alive)| alive.then_some(n))
        .collect();
    kept.par_sort_unstable();
    kept
}

#[cfg(test)]
mod tests;
