//! Which sensor measured a cloud: a known one, or a model fitted to the cloud.

use glam::Vec3;

use super::approx::atan2_f32;
use super::order::rings_by_order;
use super::recovery::recover_rings;
use super::rings::{Beams, CLEAR, NO_RING, RingRecovery, Sight, median, median_elevations, sample};
use super::{MAX_BEAMS, MAX_COLUMNS, SensorModel, model, names};

/// How many returns are enough to tell which known sensor it was.
const SAMPLE: u32 = 20_000;
/// A known sensor's columns are replaced by the measured ones where these differ by more than this share.
const COLUMNS_DIFFER: f64 = 0.0025;
/// Ranges of a fitted model that resembles no known sensor, metres.
const FITTED_RANGES_M: (f32, f32) = (0.3, 200.0);
/// Bin of the elevation histogram.
const BIN_DEG: f32 = 0.01;
/// Between two peaks of the histogram it falls below this share of both.
const VALLEY: f32 = 0.3;
/// Fewer returns than this are no beam.
const PEAK_RETURNS: f32 = 20.0;

/// The sensor that measured a cloud (sensor frame, metres); `None` where no beams show (Livox, depth cameras).
///
/// A known sensor if its beams explain the elevations; otherwise a model fitted to the given rings (0 = lowest, see
/// [`super::sort_rings`]), to the rings that the order of the points shows, or to the peaks of the elevations. A fitted
/// model that resembles a known sensor is called after it, `hdl64e-fitted`, and has its ranges.
pub fn guess(points: &[Vec3], rings: Option<&[u16]>) -> Option<SensorModel> {
    if let Some(known) = known(points, rings) {
        return Some(known);
    }
    if let Some(rings) = rings {
        return fitted(points, rings, complete(&median_elevations(points, rings))?);
    }
    if let Some(ordered) = rings_by_order(points) {
        return fitted(points, &ordered.recovery.rings, ordered.elevations_deg);
    }
    let peaks = SensorModel::from_beams("peaks", peaks(points), 1, FITTED_RANGES_M).ok()?;
    let by_peaks = Beams::new(&peaks).recover(points);
    (peaks.rings() >= 4 && by_peaks.within_tolerance >= CLEAR)
        .then(|| fitted(points, &by_peaks.rings, peaks.elevations_deg))
        .flatten()
}

/// The known sensor that explains a sample best, with the columns measured.
fn known(points: &[Vec3], rings: Option<&[u16]>) -> Option<SensorModel> {
    let chosen: Vec<usize> = sample(points, SAMPLE).collect();
    let sampled: Vec<Vec3> = chosen.iter().map(|&i| points[i]).collect();
    let given = rings.map(|rings| -> Vec<u16> { chosen.iter().filter_map(|&i| rings.get(i).copied()).collect() });
    let fits = names().iter().filter_map(|name| {
        let model = model(name)?;
        let found = Beams::new(&model).recover(&sampled);
        let agrees = given.as_ref().is_none_or(|given| agrees(&found.rings, given));
        let fits = found.within_tolerance >= CLEAR && uses_its_beams(&found, model.rings()) && agrees;
        fits.then_some((found.within_tolerance, model))
    });
    // The first of equals.
    let (_, mut best) = fits.reduce(|best, next| if next.0 > best.0 { next } else { best })?;
    let measured = columns(points, &recover_rings(points, &best).rings, best.rings());
    let differ = |&columns: &u32| (f64::from(columns) / f64::from(best.columns) - 1.0).abs() > COLUMNS_DIFFER;
    best.columns = measured.filter(differ).unwrap_or(best.columns);
    Some(best)
}

/// Whether nearly all beams between the lowest and the highest in use are in use; those above may all look at the sky.
fn uses_its_beams(found: &RingRecovery, beams: usize) -> bool {
    let mut used = vec![false; beams];
    for &ring in &found.rings {
        if let Some(used) = used.get_mut(usize::from(ring)) {
            *used = true;
        }
    }
    let (first, last) = (used.iter().position(|&u| u), used.iter().rposition(|&u| u));
    let count = used.iter().filter(|&&u| u).count();
    let span = first.zip(last).map_or(0, |(first, last)| last + 1 - first);
    count * 10 >= span * 8 && count * 10 >= beams * 4
}

/// Whether two numberings of the rings are the same for nearly all points.
fn agrees(found: &[u16], given: &[u16]) -> bool {
    let same = found.iter().zip(given).filter(|(f, g)| f == g).count();
    same as f32 >= CLEAR * found.len() as f32
}

/// Elevations without gaps: rings that returned nothing lie evenly between (or beyond) their neighbours.
fn complete(elevations: &[Option<f32>]) -> Option<Vec<f32>> {
    let present: Vec<(usize, f32)> = (0..).zip(elevations).filter_map(|(r, e)| e.map(|e| (r, e))).collect();
    let between = |ring: usize| {
        let above = present.partition_point(|p| p.0 < ring).clamp(1, present.len() - 1);
        let ((r0, e0), (r1, e1)) = (present[above - 1], present[above]);
        e0 + (e1 - e0) * (ring as f32 - r0 as f32) / (r1 - r0) as f32
    };
    (present.len() >= 2).then(|| (0..elevations.len()).map(between).collect())
}

/// A model with the given beams, ascending, and the columns of the cloud.
fn fitted(points: &[Vec3], rings: &[u16], elevations_deg: Vec<f32>) -> Option<SensorModel> {
    let columns = columns(points, rings, elevations_deg.len())?;
    let alike = names()
        .iter()
        .filter_map(|name| model(name))
        .find(|known| resemble(&known.elevations_deg, &elevations_deg));
    let (name, ranges) = match alike {
        Some(known) => (known.name + "-fitted", (known.min_range_m, known.max_range_m)),
        None => (format!("fitted-{}", elevations_deg.len()), FITTED_RANGES_M),
    };
    let model = SensorModel {
        name,
        elevations_deg,
        columns,
        min_range_m: ranges.0,
        max_range_m: ranges.1,
    };
    model.check().is_ok().then_some(model)
}

/// Whether two tables have as many beams and these are, on average, within 3 % of the field of view.
fn resemble(known: &[f32], fitted: &[f32]) -> bool {
    let off: f32 = known.iter().zip(fitted).map(|(k, f)| (k - f).abs()).sum();
    let span = known
        .last()
        .zip(known.first())
        .map_or(0.0, |(last, first)| last - first);
    known.len() == fitted.len() && off < 0.03 * span * known.len() as f32
}

/// Firings in a turn, from the steps in azimuth between the returns of each ring.
fn columns(points: &[Vec3], rings: &[u16], beams: usize) -> Option<u32> {
    let mut azimuths: Vec<Vec<f32>> = vec![Vec::new(); beams.min(MAX_BEAMS)];
    for (&p, &ring) in points
        .iter()
        .zip(rings)
        .filter(|(p, ring)| **ring != NO_RING && Sight::of(**p).is_some())
    {
        if let Some(of_ring) = azimuths.get_mut(usize::from(ring)) {
            of_ring.push(atan2_f32(p.y, p.x));
        }
    }
    let least = 0.5 * std::f32::consts::TAU / MAX_COLUMNS as f32;
    let mut steps: Vec<f32> = Vec::new();
    for azimuths in &mut azimuths {
        azimuths.sort_unstable_by(f32::total_cmp);
        // Second returns of a firing lie in the same direction.
        let mut of_ring: Vec<f32> = azimuths
            .windows(2)
            .map(|w| w[1] - w[0])
            .filter(|&s| s > least)
            .collect();
        let Some(middle) = median(&mut of_ring).filter(|_| of_ring.len() >= 32) else {
            continue;
        };
        // The usual step, not the mean one: where azimuths are coded they differ (KITTI: 0.180° and 0.167°). Columns too
        // wide cost the returns that collide, columns too narrow tear holes, and each hole costs four normals.
        of_ring.retain(|s| (0.75 * middle..1.25 * middle).contains(s));
        let sum: f64 = of_ring.iter().map(|&s| f64::from(s)).sum();
        steps.push((sum / of_ring.len() as f64) as f32);
    }
    // Holes only lengthen steps: the lower quartile of the rings.
    let quartile = steps.len() / 4;
    let step = (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(quartile, f32::total_cmp).1)?;
    let columns = (std::f64::consts::TAU / f64::from(step)).round();
    (1.0..=f64::from(MAX_COLUMNS))
        .contains(&columns)
        .then_some(columns as u32)
}

/// Beams as peaks in the histogram of elevations, degrees.
fn peaks(points: &[Vec3]) -> Vec<f32> {
    let mut bins = vec![0.0f32; (180.0 / BIN_DEG) as usize + 1];
    for sight in points.iter().filter_map(|&p| Sight::of(p)) {
        bins[((sight.elevation_deg + 90.0) / BIN_DEG) as usize] += 1.0;
    }
    // Smoothed over five bins, because noise and rounding spread a beam over a few.
    let smooth: Vec<f32> = (2..bins.len() - 2).map(|i| bins[i - 2..=i + 2].iter().sum()).collect();
    let mut peaks = Vec::new();
    let (mut top, mut valley) = ((0, 0.0f32), 0.0f32);
    for (i, &height) in smooth.iter().chain([&0.0]).enumerate() {
        if height > top.1 && height * VALLEY >= valley {
            top = (i, height);
        }
        valley = valley.min(height);
        if height < VALLEY * top.1 {
            if top.1 >= PEAK_RETURNS {
                // Centre of mass of the bins around the top.
                let around = top.0..=top.0 + 4;
                let mass: f32 = bins[around.clone()].iter().sum();
                let moment: f32 = around.map(|b| bins[b] * (b as f32 - top.0 as f32 + 0.5)).sum();
                peaks.push((top.0 as f32 + moment / mass) * BIN_DEG - 90.0);
            }
            (top, valley) = ((0, 0.0), height);
        }
    }
    peaks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::testing::{random, scan_room};

    #[test]
    fn every_known_sensor_is_recognised_with_and_without_rings() {
        for name in names() {
            let known = model(name).unwrap();
            let (points, rings) = scan_room(&known, |_| 0.0);
            assert_eq!(guess(&points, None).as_ref(), Some(&known));
            assert_eq!(guess(&points, Some(&rings)), Some(known));
        }
    }

    #[test]
    fn another_rotation_rate_is_measured() {
        let mut turning = model("os1-64").unwrap();
        turning.columns = 2048;
        let (points, _) = scan_room(&turning, |_| 0.3);
        assert_eq!(guess(&points, None), Some(turning));
    }

    /// A sensor that is in no table, with a quarter of the returns missing.
    fn unknown() -> (SensorModel, Vec<Vec3>, Vec<u16>) {
        let beams = (0..40).map(|i| -17.0 + 0.7 * i as f32 + 0.2 * random(i)).collect();
        let sensor = SensorModel::from_beams("unknown", beams, 1500, (0.3, 99.0)).unwrap();
        let (points, rings) = scan_room(&sensor, |ring| f64::from(random(ring)));
        let kept = (0..points.len()).filter(|&i| random(i) > 0.25);
        let (points, rings) = kept.map(|i| (points[i], rings[i])).unzip();
        (sensor, points, rings)
    }

    #[test]
    fn an_unknown_sensor_is_fitted_from_its_rings_or_from_peaks() {
        let (sensor, points, rings) = unknown();
        for rings in [Some(rings.as_slice()), None] {
            let fitted = guess(&points, rings).unwrap();
            assert_eq!(
                (fitted.name.as_str(), fitted.rings(), fitted.columns),
                ("fitted-40", 40, 1500)
            );
            for (fit, want) in fitted.elevations_deg.iter().zip(&sensor.elevations_deg) {
                assert!((fit - want).abs() < 0.01, "{fit} {want}");
            }
        }
    }

    #[test]
    fn rings_without_returns_keep_their_number() {
        let (sensor, points, rings) = unknown();
        let seen = (0..points.len()).filter(|&i| !matches!(rings[i], 0 | 7));
        let (points, rings): (Vec<Vec3>, Vec<u16>) = seen.map(|i| (points[i], rings[i])).unzip();
        let fitted = guess(&points, Some(&rings)).unwrap();
        assert_eq!(fitted.rings(), 40);
        assert!((fitted.elevations_deg[39] - sensor.elevations_deg[39]).abs() < 0.01);
        assert!((fitted.elevations_deg[7] - sensor.elevations_deg[7]).abs() < 0.3);
    }

    #[test]
    fn clouds_without_beams_are_declined() {
        let anywhere = |n: usize| -> Vec<Vec3> {
            let at = |i| Vec3::new(random(3 * i) - 0.5, random(3 * i + 1) - 0.5, random(3 * i + 2) - 0.5);
            (0..n).map(|i| at(i) * 20.0).collect()
        };
        // A rosette, as of a Livox: elevations and azimuths both within its field of view, in smooth curves.
        let rosette = (0..100_000).map(|i| {
            let t = i as f32 * 0.002;
            let r = 0.6 * (t * 3.7).sin();
            Vec3::new(1.0, r * (t * 0.37).cos(), r * (t * 0.37).sin()) * 8.0
        });
        for cloud in [
            vec![],
            anywhere(1),
            anywhere(1000),
            anywhere(100_000),
            rosette.collect(),
            vec![Vec3::X; 5000],
        ] {
            assert_eq!(guess(&cloud, None), None, "{}", cloud.len());
        }
    }
}
