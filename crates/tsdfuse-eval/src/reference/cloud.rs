//! The nearest point of a cloud.

use nabo::{CandidateContainer, KDTree, NotNan, Parameters};
use tsdfuse::glam::DVec3;

use super::coherent;

/// Points in the tree are rounded to multiples of this, metres: 60 nm. The tree splits at the middle between two coordinates,
/// which must differ from both, so they must not be adjacent floats. Up to 2²⁷ m the middle is exact.
const STEP_M: f64 = 1.0 / 16_777_216.0;

/// A k-d tree over points.
#[derive(Debug)]
pub(crate) struct CloudTree(KDTree<f64, Point>);

impl CloudTree {
    /// Builds the tree of one or more valid points.
    pub(crate) fn new(points: &[DVec3]) -> Self {
        let points: Vec<_> = points
            .iter()
            .map(|&p| Point::of((p / STEP_M).round() * STEP_M))
            .collect();
        Self(KDTree::new(&points))
    }

    /// The distance from each of `points` to the nearest one of the tree, metres.
    pub(crate) fn distances(&self, points: &[DVec3]) -> Vec<f64> {
        const EXACT: Parameters<f64> = Parameters {
            epsilon: 0.0,
            max_radius: f64::INFINITY,
            allow_self_match: true,
            sort_results: false,
        };
        let distance = |p| {
            let found = self
                .0
                .knn_advanced(1, &Point::of(p), CandidateContainer::Linear, &EXACT, None);
            found.first().map_or(f64::INFINITY, |nearest| nearest.dist2.sqrt())
        };
        coherent::answers(points, distance)
    }
}

/// A point in the form that the tree requires.
#[derive(Clone, Copy, Debug, Default)]
struct Point([NotNan<f64>; 3]);

impl Point {
    /// NaN becomes 0; callers pass none.
    fn of(p: DVec3) -> Self {
        Self(p.to_array().map(|c| NotNan::new(c).unwrap_or_default()))
    }
}

impl nabo::Point<f64> for Point {
    const DIM: u32 = 3;

    fn set(&mut self, i: u32, value: NotNan<f64>) {
        self.0[i as usize] = value;
    }

    fn get(&self, i: u32) -> NotNan<f64> {
        self.0[i as usize]
    }
}
