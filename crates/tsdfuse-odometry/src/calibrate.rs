//! Systematic errors that all beams of a sensor share, found by trial: with the right correction, scans lie best on what the others saw.
//!
//! Least squares do not find them: planes through returns that all have the same error hardly contradict any of them, and poses hide much of
//! what is left. The distance of returns from what the other scans saw, with poses that were refined under the same correction, has its
//! minimum where the correction is right. (The share of returns that match has no such maximum: where scans disagree, more is tolerated.)

use tsdfuse::Scan;
use tsdfuse::sensor::SensorCorrection;

use crate::refiner::Refiner;
use crate::tracker::OdometryConfig;

/// Rounds of refinement under each correction that is tried, and how far surfaces are looked for, metres.
const ROUNDS: usize = 2;
const REACH_M: f64 = 0.1;

/// The step of the search, and the least correction that matters.
struct Axis {
    step: f64,
    least: f64,
    of: fn(&mut SensorCorrection) -> &mut f64,
}

/// Elevation, degrees, range, metres, and elevation again, since an error of ranges shifts it.
const AXES: [Axis; 3] = [
    Axis {
        step: 0.2,
        least: 0.05,
        of: |correction| &mut correction.elevation_deg,
    },
    Axis {
        step: 0.04,
        least: 0.01,
        of: |correction| &mut correction.range_m,
    },
    Axis {
        step: 0.1,
        least: 0.05,
        of: |correction| &mut correction.elevation_deg,
    },
];

/// Steps that are gone at most while it becomes better.
const MOST_STEPS: usize = 5;

/// By how many standard errors, and by which share, a correction must bring scans nearer to each other.
const SURE: f64 = 5.0;
const GAIN: f64 = 0.05;

/// Finds the errors of elevations and ranges that all beams share, from scans that follow each other, with refined poses; what takes them back.
/// `None` if there are none beyond doubt.
///
/// Some 30 scans tell; each trial takes as long as two rounds of refining them, and five trials tell of most sensors that there are none.
pub fn shared_errors(scans: &[Scan], config: OdometryConfig) -> Option<SensorCorrection> {
    let mut found = SensorCorrection::default();
    let mut distances_of_found = distances(scans, &found, config);
    for (round, Axis { step, least, of }) in AXES.into_iter().enumerate() {
        if round == 2 && found.is_none() {
            break;
        }
        let start = *of(&mut found);
        let at = |value: f64| {
            let mut tried = found.clone();
            *of(&mut tried) = value;
            tried
        };
        let trial = |value: f64| (value, distances(scans, &at(value), config).iter().sum::<f64>());
        let mut middle = (start, distances_of_found.iter().sum::<f64>());
        let (mut below, mut above) = (trial(start - step), trial(start + step));
        for _ in 0..MOST_STEPS {
            if above.1 < middle.1 && above.1 <= below.1 {
                (below, middle) = (middle, above);
                above = trial(middle.0 + step);
            } else if below.1 < middle.1 {
                (above, middle) = (middle, below);
                below = trial(middle.0 - step);
            } else {
                break;
            }
        }
        // The vertex of the parabola through the best and its neighbours.
        let (left, right) = (below.1 - middle.1, above.1 - middle.1);
        if !(left >= 0.0 && right >= 0.0 && left + right > 0.0) {
            continue;
        }
        let best = middle.0 + 0.5 * step * (left - right) / (left + right);
        if best.abs() >= least && best != start {
            let tried = at(best);
            let after = distances(scans, &tried, config);
            // What is corrected already need not gain much more.
            let gain = if round == 2 { 0.0 } else { GAIN };
            if is_less(&after, &distances_of_found, gain) {
                (found, distances_of_found) = (tried, after);
            }
        }
    }
    (!found.is_none()).then_some(found)
}

/// For each scan, the mean distance of its returns from what the others saw, metres, with this correction.
fn distances(scans: &[Scan], correction: &SensorCorrection, config: OdometryConfig) -> Vec<f64> {
    let mut scans = scans.to_vec();
    scans.iter_mut().for_each(|scan| correction.apply(scan));
    let mut distances = Vec::new();
    for _ in 0..ROUNDS {
        let mut refiner = Refiner::new(config, REACH_M);
        let mut refined: Vec<_> = scans.iter().flat_map(|scan| refiner.push(scan)).collect();
        refined.extend(refiner.finish());
        for (scan, refined) in scans.iter_mut().zip(&refined) {
            if let Some(refined) = refined {
                refined.place(scan);
            }
        }
        distances.clone_from(&refiner.errors().off_m);
    }
    distances
}

/// Whether distances are less beyond doubt, scan by scan, and at least by this share in the mean.
fn is_less(distances: &[f64], than: &[f64], by: f64) -> bool {
    let n = distances.len() as f64;
    let gains = || than.iter().zip(distances).map(|(a, b)| a - b);
    let mean = gains().sum::<f64>() / n;
    let variance = gains().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (n - 1.0);
    mean > SURE * (variance / n).sqrt() && mean * n > by * than.iter().sum::<f64>()
}
