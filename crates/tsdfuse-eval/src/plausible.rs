//! Reasons to doubt the figures: different units, different places.

use crate::figures::{Inputs, Measures};
use crate::protocol::Protocol;

/// Units that are mistaken for metres, and their number per metre.
const UNITS: [(&str, f64); 5] = [
    ("millimetres", 1000.0),
    ("centimetres", 100.0),
    ("inches", 1.0 / 0.0254),
    ("feet", 1.0 / 0.3048),
    ("kilometres", 0.001),
];

/// The tolerance of a unit's factor.
const SIZE_TOLERANCE: f64 = 1.25;

/// A median distance above this, metres, suggests another place rather than an error.
const ANOTHER_PLACE_M: f64 = 1.0;

/// Reasons to doubt the figures, one sentence each.
pub(crate) fn warnings(inputs: &Inputs, all: &Measures, protocol: &Protocol) -> Vec<String> {
    let [mesh, reference] = [inputs.mesh_bounds, inputs.reference_bounds];
    let mut warnings = Vec::new();
    let threshold_m = protocol.thresholds_m.iter().copied().fold(0.0, f64::max);
    let gap_m = mesh.gap_m(&reference);
    let median_m = all.mesh_to_reference.stats.median_m;
    if gap_m > threshold_m {
        warnings.push(format!(
            "the boxes around mesh and reference do not overlap: they are {gap_m:.3} m apart ({} to {}; {} to {})",
            mesh.min, mesh.max, reference.min, reference.max
        ));
    } else if median_m > ANOTHER_PLACE_M {
        warnings.push(format!(
            "half of the mesh is more than {median_m:.3} m away from the reference: another place, or poses of another frame?"
        ));
    }
    // A mesh may cover only a part of the reference, so a size is suspicious only together with long distances.
    let far = median_m > 0.02 * mesh.diagonal_m().min(reference.diagonal_m());
    let [mesh_m, reference_m] = [mesh, reference].map(|bounds| bounds.diagonal_m());
    let ratio = reference_m / mesh_m;
    let near = |factor: f64| (ratio / factor).max(factor / ratio) < SIZE_TOLERANCE;
    let suspects = UNITS.iter().flat_map(|&(unit, factor)| {
        [("reference", factor), ("mesh", 1.0 / factor)].map(|(which, factor)| (which, unit, factor))
    });
    for (which, unit, _) in suspects.filter(|&(_, _, factor)| (far || gap_m > 0.0) && near(factor)) {
        warnings.push(format!(
            "the mesh is {mesh_m:.3} m across, the reference {reference_m:.3} m: is the {which} in {unit}?"
        ));
    }
    warnings
}
