//! The figures of a comparison.

use rayon::prelude::*;
use serde::Serialize;

use crate::bounds::Bounds;
use crate::error::{EvalError, Result};
use crate::protocol::{Limit, Protocol};
use crate::stats::{Histogram, Stats, share_within};

/// Bins of [`Direction::histogram`], and their width, metres: 0 to 50 cm.
const BINS: (usize, f64) = (250, 0.002);

/// The result of comparing a mesh with a reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The rules of the comparison.
    pub protocol: Protocol,
    /// The inputs.
    pub inputs: Inputs,
    /// The figures of all places.
    pub all: Measures,
    /// The figures of the places where the reference is dense by the protocol's rule. `None` if the reference is a mesh, which
    /// is dense everywhere, or if no place is dense.
    pub dense: Option<Dense>,
    /// Reasons to doubt the figures, one sentence each.
    pub warnings: Vec<String>,
}

/// The inputs of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inputs {
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Area of the mesh, m².
    pub area_m2: f64,
    /// The box around the mesh.
    pub mesh_bounds: Bounds,
    /// `cloud` or `mesh`.
    pub reference: &'static str,
    /// The points of the reference that completeness is measured at, before down-sampling.
    pub reference_points: usize,
    /// The box around the reference.
    pub reference_bounds: Bounds,
}

/// The figures of a region.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// Distances from samples of the mesh to the reference: accuracy.
    pub mesh_to_reference: Direction,
    /// Distances from points of the reference to the mesh: completeness.
    pub reference_to_mesh: Direction,
    /// The mean of both averages, metres.
    pub chamfer_l1_m: f64,
    /// The root of the mean of both mean squares, metres.
    pub chamfer_l2_m: f64,
    /// Shares at each of the protocol's thresholds.
    pub thresholds: Vec<AtThreshold>,
}

/// The distances of one direction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Direction {
    /// Statistics of the distances that count.
    #[serde(flatten)]
    pub stats: Stats,
    /// The number of distances that the protocol's limit left out.
    pub left_out: usize,
    /// The number of distances that the protocol's limit shortened.
    pub clamped: usize,
    /// Histogram of the distances that count.
    pub histogram: Histogram,
}

/// Shares within a threshold, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AtThreshold {
    /// The threshold; a distance equal to it is within it.
    pub threshold_m: f64,
    /// The share of the mesh's samples that are within the threshold of the reference.
    pub precision: f64,
    /// The share of the reference's points that are within the threshold of the mesh: recall.
    pub completeness: f64,
    /// The harmonic mean of both.
    pub f_score: f64,
}

/// The figures of the densely observed places.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Dense {
    /// The share of the mesh's samples that lie there.
    pub share_of_mesh: f64,
    /// The share of the reference's points that lie there.
    pub share_of_reference: f64,
    /// Their figures.
    #[serde(flatten)]
    pub measures: Measures,
}

impl Measures {
    pub(crate) fn of(to_reference: &[f64], to_mesh: &[f64], protocol: &Protocol) -> Result<Self> {
        let (there, mesh_to_reference) =
            Direction::of(to_reference, protocol.accuracy_limit, "the mesh to the reference")?;
        let (back, reference_to_mesh) =
            Direction::of(to_mesh, protocol.completeness_limit, "the reference to the mesh")?;
        let [a, b] = [mesh_to_reference.stats, reference_to_mesh.stats];
        let at = |&threshold_m: &f64| {
            let [precision, completeness] = [&there, &back].map(|d| share_within(d, threshold_m));
            let sum = precision + completeness;
            AtThreshold {
                threshold_m,
                precision,
                completeness,
                f_score: if sum > 0.0 {
                    2.0 * precision * completeness / sum
                } else {
                    0.0
                },
            }
        };
        Ok(Self {
            chamfer_l1_m: (a.mean_m + b.mean_m) / 2.0,
            chamfer_l2_m: ((a.rmse_m.powi(2) + b.rmse_m.powi(2)) / 2.0).sqrt(),
            thresholds: protocol.thresholds_m.iter().map(at).collect(),
            mesh_to_reference,
            reference_to_mesh,
        })
    }
}

impl Direction {
    /// The distances that count, and their figures.
    pub(crate) fn of(distances: &[f64], limit: Option<Limit>, direction: &'static str) -> Result<(Vec<f64>, Self)> {
        let beyond = |limit_m| distances.par_iter().filter(|&&d| d >= limit_m).count();
        let (counting, left_out, clamped): (Vec<f64>, _, _) = match limit {
            None => (distances.to_vec(), 0, 0),
            Some(Limit::LeaveOut(limit_m)) => {
                let within = distances.iter().copied().filter(|&d| d < limit_m);
                (within.collect(), beyond(limit_m), 0)
            }
            Some(Limit::Clamp(limit_m)) => {
                let shortened = distances.iter().map(|d| d.min(limit_m));
                (shortened.collect(), 0, beyond(limit_m))
            }
        };
        let stats = Stats::of(&counting).ok_or(EvalError::AllLeftOut {
            direction,
            points: distances.len(),
            limit_m: limit.map_or(f64::INFINITY, Limit::limit_m),
        })?;
        let (bins, bin_m) = BINS;
        let histogram = Histogram::of(&counting, bin_m, bins);
        let direction = Self {
            stats,
            left_out,
            clamped,
            histogram,
        };
        Ok((counting, direction))
    }
}
