//! Stretches of the way about which returns told nothing, once it is known how the sensor went on.
//!
//! While scans come, the motion before goes on where returns do not tell the position ([`Quality::is_undetermined`]). A car that leaves from
//! rest in a tunnel so stands still until something tells its speed. Once the whole trajectory is there, the speeds on both sides of such a gap are
//! known, and in between the speed is taken to change evenly, along the direction that was not determined.
//!
//! Returns can deceive, too, where few of them tell the position, as in a tunnel: what sticks out is taken for something else, or was put into the map
//! at a wrong place. So there, stretches count as known only if the speed does not jump, if they are long enough, and if a vehicle can get from
//! their speed to that of the stretches around.

use std::ops::Range;

use glam::DVec3;

use crate::refiner::Refined;

/// A stretch with fewer steps from scan to scan is not believed.
const LEAST_STEPS: usize = 4;

/// The speed of a stretch at one of its ends is the median of so many steps.
const TELLING: usize = 3;

/// Scans whose position is known no better than this, metres, were placed by few returns.
const WEAK_M: f64 = 0.02;

/// How far the speed of such scans may be from that of the next, m/s, and more with the time between, m/s²: else it jumps.
const JUMP: (f64, f64) = (0.2, 3.0);

/// The same for the speeds on both sides of a gap.
const CHANGE: (f64, f64) = (0.5, 6.0);

/// A gap is left as it is if the way through it is off by less, metres: what was seen before it held it, …
const LEAST_OFF: f64 = 0.05;

/// … more with the square of the time that it takes, m/s²: speeds do not change evenly.
const LEAST_OFF_GROWS: f64 = 0.02;

/// The steps between scans that follow each other.
struct Steps {
    secs: Vec<f64>,
    velocities: Vec<DVec3>,
    /// Of each scan: the direction in which it may be undetermined, of the same sense as the one before.
    directions: Vec<DVec3>,
}

impl Steps {
    /// `None` unless each scan is later than the one before.
    fn of(secs: &[f64], scans: &[Refined]) -> Option<Self> {
        let both = || secs.windows(2).zip(scans.windows(2));
        if !both().all(|(secs, _)| secs[1] > secs[0]) {
            return None;
        }
        let velocities = both().map(|(secs, scans)| {
            let way = scans[1].pose.translation - scans[0].pose.translation;
            way / (secs[1] - secs[0])
        });
        let mut last = DVec3::ZERO;
        let directions = scans.iter().map(|scan| {
            let direction = DVec3::from_array(scan.quality.worst_direction);
            last = if direction.dot(last) < 0.0 {
                -direction
            } else {
                direction
            };
            last
        });
        Some(Self {
            secs: secs.to_vec(),
            velocities: velocities.collect(),
            directions: directions.collect(),
        })
    }

    /// How fast a stretch begins or ends along a direction.
    fn speed(&self, mut steps: impl Iterator<Item = usize>, direction: DVec3) -> f64 {
        let mut speeds = [0.0; TELLING];
        for (speed, step) in speeds.iter_mut().zip(&mut steps) {
            *speed = self.velocities[step].dot(direction);
        }
        speeds.sort_by(f64::total_cmp);
        speeds[TELLING / 2]
    }

    fn first_speed(&self, stretch: &Range<usize>, direction: DVec3) -> f64 {
        self.speed(stretch.clone(), direction)
    }

    fn last_speed(&self, stretch: &Range<usize>, direction: DVec3) -> f64 {
        self.speed(stretch.clone().rev(), direction)
    }

    /// Whether the speed jumps from a step to the next.
    fn jumps(&self, step: usize) -> bool {
        let direction = self.directions[step + 1];
        let [before, after] = [step, step + 1].map(|step| self.velocities[step].dot(direction));
        !is_within(JUMP, after - before, 0.5 * (self.secs[step + 2] - self.secs[step]))
    }

    /// Of stretches in order, those that are believed: the longest, and what can be reached from there.
    fn believed(&self, stretches: Vec<Range<usize>>) -> Vec<Range<usize>> {
        let long = |stretch: &Range<usize>| stretch.len() >= LEAST_STEPS;
        let stretches: Vec<Range<usize>> = stretches.into_iter().filter(long).collect();
        let Some(longest) = (0..stretches.len()).rev().max_by_key(|&k| stretches[k].len()) else {
            return Vec::new();
        };
        let follows = |before: &Range<usize>, after: &Range<usize>| {
            let secs = self.secs[after.start] - self.secs[before.end];
            let [out, back] = [before.end, after.start].map(|scan| self.directions[scan]);
            let change = self.first_speed(after, back) - self.last_speed(before, out);
            is_within(CHANGE, change, secs)
        };
        let mut believed = vec![stretches[longest].clone()];
        for stretch in stretches[..longest].iter().rev() {
            if follows(stretch, &believed[0]) {
                believed.insert(0, stretch.clone());
            }
        }
        for stretch in &stretches[longest + 1..] {
            if believed.last().is_some_and(|last| follows(last, stretch)) {
                believed.push(stretch.clone());
            }
        }
        believed
    }

    /// By how much each step through a gap is too slow, m/s along the direction of its scan; `None` for a gap that can stay as it is.
    fn slow(&self, gap: Range<usize>, before: Option<&Range<usize>>, after: Option<&Range<usize>>) -> Option<Vec<f64>> {
        let [out, back] = [gap.start, gap.end].map(|scan| self.directions[scan]);
        let first = before.map(|stretch| self.last_speed(stretch, out));
        let last = after.map(|stretch| self.first_speed(stretch, back));
        // The log begins as it was tracked, and ends as before.
        let first = first.unwrap_or_else(|| self.velocities[gap.start].dot(out));
        let last = last.unwrap_or(first);
        let (begin, secs) = (self.secs[gap.start], self.secs[gap.end] - self.secs[gap.start]);
        let slow = gap.clone().map(|step| {
            let middle = 0.5 * (self.secs[step] + self.secs[step + 1]);
            let speed = first + (last - first) * ((middle - begin) / secs);
            speed - self.velocities[step].dot(self.directions[step])
        });
        let slow: Vec<f64> = slow.collect();
        let off = |(step, slow): (usize, &f64)| slow * (self.secs[step + 1] - self.secs[step]);
        let off: f64 = gap.zip(&slow).map(off).sum();
        (off.abs() > LEAST_OFF + LEAST_OFF_GROWS * secs * secs).then_some(slow)
    }
}

/// Whether a change of speed is possible in some time.
fn is_within((least, grows): (f64, f64), change: f64, secs: f64) -> bool {
    change.abs() <= least + grows * secs
}

/// Corrects the way through stretches of one trajectory about which returns told nothing, and what follows; the first scan stays. `secs` is when each
/// scan began. Scans that told where they are, but cannot have been right, are undetermined then.
///
/// It is meant for trajectories from returns alone: accelerometers, positions and closed loops know better.
pub fn bridge(secs: &[f64], scans: &mut [Refined]) {
    let is_told = |scan: &Refined| !scan.quality.is_undetermined();
    let is_weak = |scan: &Refined| scan.quality.position_sigma_m >= WEAK_M;
    if secs.len() != scans.len() || scans.len() < 2 || !scans.iter().any(is_weak) {
        return;
    }
    let Some(steps) = Steps::of(secs, scans) else {
        return;
    };
    let mut stretches: Vec<Range<usize>> = Vec::new();
    for step in (0..scans.len() - 1).filter(|step| scans[*step..=step + 1].iter().all(is_told)) {
        let goes_on = |last: &Range<usize>| {
            last.end == step && !(scans[step - 1..=step + 1].iter().all(is_weak) && steps.jumps(step - 1))
        };
        match stretches.last_mut() {
            Some(last) if goes_on(last) => last.end += 1,
            _ => stretches.push(step..step + 1),
        }
    }
    let believed = steps.believed(stretches);
    if believed.is_empty() {
        return;
    }
    let mut slow = vec![0.0; steps.velocities.len()];
    let mut in_gap = vec![false; steps.velocities.len()];
    let mut begin = 0;
    for k in 0..=believed.len() {
        let after = believed.get(k);
        let gap = begin..after.map_or(steps.velocities.len(), |stretch| stretch.start);
        begin = after.map_or(steps.velocities.len(), |stretch| stretch.end);
        if gap.is_empty() {
            continue;
        }
        let before = k.checked_sub(1).and_then(|k| believed.get(k));
        in_gap[gap.clone()].fill(true);
        if let Some(gap_slow) = steps.slow(gap.clone(), before, after) {
            slow[gap].copy_from_slice(&gap_slow);
        }
    }
    let mut shift = DVec3::ZERO;
    for (i, scan) in scans.iter_mut().enumerate() {
        // The last scan moves as the one before.
        let step = i.min(slow.len() - 1);
        let faster = slow[step] * steps.directions[step];
        scan.pose.translation += shift;
        for at in &mut scan.motion {
            at.pose.translation += shift + at.secs * faster;
        }
        if in_gap[step] && in_gap[i.saturating_sub(1)] && i > 0 {
            scan.quality.forget_position();
        }
        if let Some(secs) = secs.get(i + 1).map(|next| next - secs[i]) {
            shift += secs * faster;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracker::Quality;
    use tsdfuse::{Pose, scan::PoseAt};

    const STEP: f64 = 0.1;

    /// Scans at these places along x; those that are `told` are determined.
    fn drive(places: &[f64], told: impl Fn(usize) -> bool) -> Vec<Refined> {
        let speed = |i: usize| (places[(i + 1).min(places.len() - 1)] - places[i]) / STEP;
        let at = |x: f64| Pose {
            translation: DVec3::new(x, 2.0, 0.0),
            ..Pose::IDENTITY
        };
        let scan = |(i, &x): (usize, &f64)| Refined {
            pose: at(x),
            motion: vec![PoseAt {
                secs: STEP,
                pose: at(x + STEP * speed(i)),
            }],
            quality: Quality {
                position_sigma_m: if told(i) { 0.03 } else { 1e6 },
                // Of either sense.
                worst_direction: if i % 3 == 0 { [-1.0, 0.0, 0.0] } else { [1.0, 0.0, 0.0] },
                ..Quality::GIVEN
            },
        };
        places.iter().enumerate().map(scan).collect()
    }

    fn secs(count: usize) -> Vec<f64> {
        (0..count).map(|i| STEP * i as f64).collect()
    }

    /// Places after speeds.
    fn places(speeds: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut x = 0.0;
        speeds.map(|speed| (x, x += STEP * speed).0).collect()
    }

    fn worst(scans: &[Refined], truth: &[f64]) -> f64 {
        let off = scans
            .iter()
            .zip(truth)
            .map(|(scan, x)| (scan.pose.translation.x - x).abs());
        off.fold(0.0, f64::max)
    }

    /// From rest to 8 m/s at an even rate, then on at that speed.
    fn truth() -> Vec<f64> {
        places((0..80).map(|i| (2.0 * STEP * (i as f64 - 9.5)).clamp(0.0, 8.0)))
    }

    #[test]
    fn a_gap_is_crossed_at_a_speed_that_changes_evenly() {
        let truth = truth();
        // It stood still in the gap.
        let told = |i: usize| !(10..=50).contains(&i);
        let stood = truth.iter().enumerate();
        let stood: Vec<f64> = stood
            .map(|(i, &x)| match i {
                0..=50 => truth[i.min(10)],
                _ => truth[10] + x - truth[50],
            })
            .collect();
        let mut scans = drive(&stood, told);
        assert!(worst(&scans, &truth) > 10.0);
        bridge(&secs(80), &mut scans);
        assert!(worst(&scans, &truth) < 0.25, "{}", worst(&scans, &truth));
        // Sweeps end where the next ones begin.
        for (scan, next) in scans.iter().zip(&scans[1..]) {
            let end = scan.motion[0].pose.translation;
            assert!((end - next.pose.translation).length() < 1e-9);
        }
        assert_eq!(scans.iter().filter(|scan| scan.quality.is_undetermined()).count(), 41);
    }

    #[test]
    fn what_cannot_have_been_right_is_undetermined() {
        let truth = truth();
        // For seven scans amid the gap, another speed was told; two other scans cannot tell any.
        let told = |i: usize| !(10..=50).contains(&i) || (20..27).contains(&i) || (40..42).contains(&i);
        let speeds = truth.windows(2).enumerate().map(|(i, x)| {
            if (10..50).contains(&i) {
                25.0
            } else {
                (x[1] - x[0]) / STEP
            }
        });
        let wrong = places(speeds.chain([8.0]));
        let mut scans = drive(&wrong, told);
        bridge(&secs(80), &mut scans);
        assert!(worst(&scans, &truth) < 0.25, "{}", worst(&scans, &truth));
        assert!(scans[10..=50].iter().all(|scan| scan.quality.is_undetermined()));
        assert!(!scans[9].quality.is_undetermined() && !scans[51].quality.is_undetermined());
    }

    #[test]
    fn a_log_that_ends_in_a_gap_goes_on_as_before() {
        let truth = places(std::iter::repeat_n(5.0, 40));
        let wrong = places((0..40).map(|i| if i < 20 { 5.0 } else { 1.0 }));
        let mut scans = drive(&wrong, |i| i < 20);
        bridge(&secs(40), &mut scans);
        assert!(worst(&scans, &truth) < 0.5, "{}", worst(&scans, &truth));
    }

    #[test]
    fn what_was_told_stays_as_it_is() {
        let speeds = || (0..60).map(|i| if (i / 20) % 2 == 0 { 1.0 } else { 4.0 });
        let same = |told: fn(usize) -> bool| {
            let mut before = drive(&places(speeds()), told);
            // By many returns.
            for scan in before.iter_mut().filter(|scan| !scan.quality.is_undetermined()) {
                scan.quality.position_sigma_m = 0.005;
            }
            let mut after = before.clone();
            bridge(&secs(60), &mut after);
            let poses = |scans: &[Refined]| scans.iter().map(|scan| scan.pose).collect::<Vec<_>>();
            poses(&before) == poses(&after)
        };
        // All of it; and with a gap through which it was held by what was seen before.
        assert!(same(|_| true) && same(|i| i != 30));
        // Without times in order nothing is known.
        let mut scans = drive(&places(speeds()), |i| i % 20 != 0);
        let before = scans[59].pose;
        bridge(&[0.0; 60], &mut scans);
        assert_eq!(scans[59].pose, before);
    }
}
