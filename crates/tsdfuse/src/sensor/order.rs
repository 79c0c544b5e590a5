//! Rings from the order of the points, for clouds that list one laser's whole turn after the other's (KITTI).
//!
//! Such a cloud's azimuth runs round and round; each turn is one laser. This works where elevations are blurred by
//! calibrated laser offsets and deskewing, as in KITTI's clouds of the HDL-64E.

use glam::Vec3;

use super::approx::atan2_f32;
use super::rings::{NO_RING, RingRecovery, RingSource, Sight, median};
use super::{MAX_BEAMS, SensorModel};

/// Steps against the sweep of up to this part of a turn are jitter; larger ones are a new turn.
const JITTER_TURNS: f64 = 0.05;
/// The end of a turn is looked for this far around the seam.
const SEAM_TURNS: f64 = 1.0 / 180.0;
/// Azimuth sectors in which the consistency of rings is judged: fine, because laser offsets make elevation depend on range.
const SECTORS: usize = 180;
/// Of the steps from point to point, at least this share goes the same way.
const SAME_WAY: f64 = 0.9;
/// At least this share of the points must be consistent.
const CONSISTENT: f32 = 0.8;

/// Rings found from the order of points.
#[derive(Clone, Debug, PartialEq)]
pub struct OrderedRings {
    /// The rings, numbered from the lowest.
    pub recovery: RingRecovery,
    /// Median elevation of each, degrees, ascending.
    pub elevations_deg: Vec<f32>,
}

/// A valid point on its way around.
struct Step {
    point: usize,
    /// Turns since the first point, in the direction of the sweep.
    turns: f64,
    elevation_deg: f32,
}

/// Finds rings by the order of the points (sensor frame); `None` where the order does not show them.
pub fn rings_by_order(points: &[Vec3]) -> Option<OrderedRings> {
    let steps = unwrap(points)?;
    let ends = turn_ends(&steps)?;
    let bounds = || {
        std::iter::once(0)
            .chain(ends.iter().copied())
            .zip(ends.iter().copied().chain([steps.len()]))
    };
    let mut turns: Vec<(f32, &[Step])> = bounds()
        .filter_map(|(start, end)| {
            let mut elevations: Vec<f32> = steps[start..end].iter().map(|s| s.elevation_deg).collect();
            median(&mut elevations).map(|m| (m, &steps[start..end]))
        })
        .collect();
    turns.sort_by(|a, b| a.0.total_cmp(&b.0));

    let mut rings = vec![NO_RING; points.len()];
    for (ring, (_, turn)) in turns.iter().enumerate() {
        turn.iter().for_each(|step| rings[step.point] = ring as u16);
    }
    let (within_tolerance, median_deviation_deg) = consistency(&turns);
    let found = OrderedRings {
        recovery: RingRecovery {
            rings,
            source: RingSource::Order,
            within_tolerance,
            median_deviation_deg,
        },
        elevations_deg: turns.iter().map(|t| t.0).collect(),
    };
    (within_tolerance >= CONSISTENT).then_some(found)
}

impl OrderedRings {
    /// Numbers the rings as a known sensor does, which may have lasers without any return; `None` if it has too few.
    pub(super) fn named_after(mut self, model: &SensorModel) -> Option<RingRecovery> {
        let (found, beams) = (self.elevations_deg.len(), model.rings());
        if found > beams {
            return None;
        }
        let mut names: Vec<u16> = Vec::with_capacity(found);
        for (i, elevation) in self.elevations_deg.iter().enumerate() {
            let lowest = names.last().map_or(0, |&n| usize::from(n) + 1);
            let free = lowest..=beams - (found - i);
            let off = |&r: &usize| (model.elevations_deg[r] - elevation).abs();
            names.push(free.min_by(|a, b| off(a).total_cmp(&off(b)))? as u16);
        }
        for ring in &mut self.recovery.rings {
            *ring = names.get(usize::from(*ring)).copied().unwrap_or(NO_RING);
        }
        Some(self.recovery)
    }
}

/// Azimuths as one growing angle; `None` if they do not go round in one direction.
fn unwrap(points: &[Vec3]) -> Option<Vec<Step>> {
    let mut steps: Vec<Step> = Vec::with_capacity(points.len());
    for (point, &p) in points.iter().enumerate() {
        if let Some(sight) = Sight::of(p) {
            steps.push(Step {
                point,
                turns: f64::from(atan2_f32(p.y, p.x)) / std::f64::consts::TAU,
                elevation_deg: sight.elevation_deg,
            });
        }
    }
    // In (−½, ½]: the shorter way round.
    let delta = |pair: &[Step]| {
        let d = pair[1].turns - pair[0].turns;
        d - (d - 0.5).ceil()
    };
    let forward = steps.windows(2).filter(|pair| delta(pair) > 0.0).count() as f64;
    let backward = steps.windows(2).filter(|pair| delta(pair) < 0.0).count() as f64;
    if !(forward.max(backward) > SAME_WAY * steps.len() as f64) {
        return None;
    }
    let way = if forward > backward { 1.0 } else { -1.0 };
    let (mut before, mut turns) = (steps[0].turns, 0.0);
    for step in &mut steps {
        let d = way * (step.turns - before);
        turns += d - (d + JITTER_TURNS).floor();
        before = step.turns;
        step.turns = turns;
    }
    Some(steps)
}

/// Where each turn but the last ends: at the largest step in elevation around the seam, which is where the first began.
fn turn_ends(steps: &[Step]) -> Option<Vec<usize>> {
    let turns = (steps.last()?.turns - SEAM_TURNS).ceil() as usize;
    if !(4..=MAX_BEAMS).contains(&turns) {
        return None;
    }
    let mut ends: Vec<usize> = Vec::with_capacity(turns);
    let mut at = 1;
    for turn in 1..turns {
        let seam = turn as f64;
        at += steps[at..].iter().position(|s| s.turns > seam - SEAM_TURNS)?;
        let jump = |i: &usize| (steps[*i].elevation_deg - steps[*i - 1].elevation_deg).abs();
        let near = steps[at..].iter().take_while(|s| s.turns < seam + SEAM_TURNS).count();
        // One past the near ones: a turn may begin after a gap.
        let end = (at..(at + near + 1).min(steps.len())).max_by(|a, b| jump(a).total_cmp(&jump(b)))?;
        ends.push(end);
        at = end + 1;
        if at >= steps.len() {
            return None;
        }
    }
    Some(ends)
}

/// Share of the points that are nearer to their own ring than to its neighbours, and their median distance from it.
fn consistency(turns: &[(f32, &[Step])]) -> (f32, f32) {
    let sector = |s: &Step| ((s.turns - s.turns.floor()) * SECTORS as f64) as usize % SECTORS;
    let means: Vec<[f32; SECTORS]> = turns
        .iter()
        .map(|&(median, turn)| {
            let mut sums = [(0.0, 0u32); SECTORS];
            for step in turn {
                let (sum, count) = &mut sums[sector(step)];
                *sum += step.elevation_deg;
                *count += 1;
            }
            sums.map(|(sum, count)| if count > 0 { sum / count as f32 } else { median })
        })
        .collect();
    let mut deviations: Vec<f32> = Vec::new();
    let mut consistent = 0usize;
    for (ring, (_, turn)) in turns.iter().enumerate() {
        for step in *turn {
            let at = sector(step);
            let off = |r: usize| {
                means
                    .get(r)
                    .map_or(f32::INFINITY, |m| (step.elevation_deg - m[at]).abs())
            };
            deviations.push(off(ring));
            consistent += usize::from(off(ring) < off(ring + 1) && off(ring) < off(ring.wrapping_sub(1)));
        }
    }
    let share = consistent as f32 / deviations.len().max(1) as f32;
    (share, median(&mut deviations).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::testing::{laser_by_laser, random, real_data, scan_room};
    use crate::sensor::{guess, model, recover_rings};
    use glam::Quat;

    /// KITTI-like: laser by laser, returns missing, a tilt that blurs elevations by more than the beam spacing.
    fn blurred(drop: f32) -> (Vec<Vec3>, Vec<u16>) {
        let (points, rings) = scan_room(&model("hdl64e").unwrap(), |ring| 3.0 * f64::from(random(ring)));
        let (points, rings) = laser_by_laser(&points, &rings);
        let tilt = Quat::from_rotation_x(1f32.to_radians());
        let kept = |i: &usize| random(*i) >= drop;
        (0..points.len())
            .filter(kept)
            .map(|i| (tilt * points[i], rings[i]))
            .unzip()
    }

    #[test]
    fn whole_turns_are_rings_even_where_elevations_overlap() {
        for drop in [0.0, 0.3] {
            let (points, rings) = blurred(drop);
            let found = rings_by_order(&points).unwrap();
            let wrong = found.recovery.rings.iter().zip(&rings).filter(|(a, b)| a != b).count();
            assert!(wrong < 200, "{wrong} of {}", rings.len());
            assert_eq!(found.elevations_deg.len(), 64);
            assert!(
                found.recovery.within_tolerance > 0.99,
                "{}",
                found.recovery.within_tolerance
            );
        }
        let reversed: Vec<Vec3> = blurred(0.3).0.into_iter().rev().collect();
        assert_eq!(rings_by_order(&reversed).unwrap().elevations_deg.len(), 64);
    }

    #[test]
    fn lasers_without_returns_are_skipped_when_numbering() {
        let hdl64e = model("hdl64e").unwrap();
        let (points, rings) = blurred(0.1);
        let seen: Vec<usize> = (0..points.len())
            .filter(|&i| !matches!(rings[i], 20 | 62 | 63))
            .collect();
        let cloud: Vec<Vec3> = seen.iter().map(|&i| points[i]).collect();
        let found = recover_rings(&cloud, &hdl64e);
        assert_eq!(found.source, RingSource::Order);
        let right = seen.iter().zip(&found.rings).filter(|(i, r)| rings[**i] == **r).count();
        assert!(right as f32 > 0.99 * seen.len() as f32, "{right} of {}", seen.len());
    }

    #[test]
    fn other_orders_show_nothing() {
        let (by_column, _) = scan_room(&model("hdl64e").unwrap(), |_| 0.0);
        assert_eq!(rings_by_order(&by_column), None);
        let anywhere: Vec<Vec3> = (0..50_000)
            .map(|i| Vec3::new(random(3 * i) - 0.5, random(3 * i + 1) - 0.5, random(3 * i + 2) - 0.5))
            .collect();
        assert_eq!(rings_by_order(&anywhere), None);
        for few in [vec![], vec![Vec3::X], vec![Vec3::NAN; 9], vec![Vec3::X; 100]] {
            assert_eq!(rings_by_order(&few), None);
        }
    }

    #[test]
    fn kitti_shows_its_64_lasers() {
        let Some(folder) = real_data("kitti00/velodyne") else {
            return;
        };
        let mut first: Option<SensorModel> = None;
        for file in (0..20).map(|i| folder.join(format!("{i:06}.bin"))) {
            let bytes = std::fs::read(&file).unwrap();
            let number = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            let point = |b: &[u8]| Vec3::new(number(b), number(&b[4..]), number(&b[8..]));
            let points: Vec<Vec3> = bytes.chunks_exact(16).map(point).collect();
            let found = rings_by_order(&points).unwrap();
            println!(
                "{}: {} rings, {:.4} consistent, median deviation {:.3} degrees",
                file.display(),
                found.elevations_deg.len(),
                found.recovery.within_tolerance,
                found.recovery.median_deviation_deg
            );
            assert_eq!(found.elevations_deg.len(), 64);
            assert!(found.recovery.within_tolerance > 0.95);
            let model = first.get_or_insert_with(|| guess(&points, None).unwrap());
            assert_eq!((model.name.as_str(), model.rings()), ("hdl64e-fitted", 64));
            assert!((1990..2030).contains(&model.columns), "{}", model.columns);
            assert_eq!(recover_rings(&points, model), found.recovery);
        }
    }
}
