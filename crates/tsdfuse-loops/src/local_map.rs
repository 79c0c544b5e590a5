//! Local maps: what a sensor saw along a stretch of its way, in one frame.

use glam::{DMat3, DQuat, DVec3, IVec3, Vec3};
use rustc_hash::FxHashSet;
use tsdfuse::eigen::eigen;
use tsdfuse::{Pose, Scan};
use tsdfuse_odometry::{OdometryConfig, SurfacePoint, Surfaces};

/// Returns of each scan that are kept at most, evenly spread over the scan.
const OF_EACH_SCAN: usize = 4000;

/// Edge of the cubes in each of which one point is kept, metres; grows until there are few enough points.
const THIN_M: f32 = 0.1;

/// Points of a local map at most.
const MOST_POINTS: usize = 25_000;

/// A local map of which a smaller share of the points lies on surfaces is sparse.
const SPARSE: f64 = 0.6;

/// Planes that lean by less than this from the vertical or horizontal tell which way is up (cosine of 72°).
const LEANING: f64 = 0.3;

/// What a sensor saw along a stretch of its way, or a part of a map: surfaces in one frame, with z roughly upwards.
#[derive(Clone, Debug)]
pub struct LocalMap {
    /// First those that lie on surfaces of the map itself.
    points: Vec<SurfacePoint>,
    /// How many do.
    telling: usize,
    /// Turns z upwards, as floors and walls tell.
    level: DQuat,
}

impl LocalMap {
    /// Of points in any order; the first one in each cube of 10 cm counts, or of larger cubes where there would be more than 25,000. The frame's z is upwards within 30°.
    pub fn new(points: &[SurfacePoint]) -> Self {
        let mut points: Vec<SurfacePoint> = points.iter().copied().filter(|p| p.at.is_finite()).collect();
        let mut size = THIN_M;
        loop {
            let mut taken: FxHashSet<IVec3> = FxHashSet::default();
            points.retain(|p| taken.insert((p.at / size).floor().as_ivec3()));
            if points.len() <= MOST_POINTS {
                break;
            }
            size *= 1.25;
        }
        let mut map = Self {
            points,
            telling: 0,
            level: DQuat::IDENTITY,
        };
        let surfaces = map.surfaces();
        map.level = level(&map.points, &surfaces);
        let points = std::mem::take(&mut map.points).into_iter();
        let (telling, others): (Vec<_>, Vec<_>) = points.partition(|p| surfaces.normal_at(p.at).is_some());
        map.telling = telling.len();
        map.points = [telling, others].concat();
        map
    }

    /// Its points.
    pub fn points(&self) -> &[SurfacePoint] {
        &self.points
    }

    /// Its points that lie on surfaces of the map itself: the others, such as far ones that one beam saw, tell no surface that others could see.
    pub(crate) fn telling(&self) -> &[SurfacePoint] {
        &self.points[..self.telling]
    }

    /// Turns a point's frame so that z is up.
    pub(crate) fn level(&self) -> DQuat {
        self.level
    }

    /// Its planes.
    pub(crate) fn surfaces(&self) -> Surfaces {
        // Fewer points than odometry's cells have, so cells are as large as suits them.
        Surfaces::new(&self.points, &OdometryConfig::default())
    }
}

/// The rotation that turns up what floors and walls say is up: at most 30° from z.
fn level(points: &[SurfacePoint], surfaces: &Surfaces) -> DQuat {
    let normals: Vec<DVec3> = points
        .iter()
        .step_by(4)
        .filter_map(|p| surfaces.normal_at(p.at))
        .collect();
    let mut up = DVec3::Z;
    for _ in 0..4 {
        // What is up lies within walls and across floors.
        let mut sum = DMat3::ZERO;
        for n in &normals {
            let lean = n.dot(up).abs();
            let outer = DMat3::from_cols(*n * n.x, *n * n.y, *n * n.z);
            if lean < LEANING {
                sum += outer;
            } else if lean > (1.0 - LEANING * LEANING).sqrt() {
                sum -= outer;
            }
        }
        let least = eigen(&sum).vectors[0];
        let next = if least.dot(up) < 0.0 { -least } else { least };
        if next.dot(DVec3::Z) < 0.866 {
            return DQuat::IDENTITY;
        }
        up = next;
    }
    DQuat::from_rotation_arc(up, DVec3::Z)
}

/// Points of scans, on their way to a local map.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gathered {
    points: Vec<(DVec3, SurfacePoint)>,
    /// Those of the local map before.
    before: Vec<(DVec3, SurfacePoint)>,
    /// Sums of the scans' median ranges.
    ranges: f64,
    scans: usize,
}

impl Gathered {
    /// Adds what a placed scan saw.
    pub(crate) fn add(&mut self, scan: &Scan) {
        let Some(pose) = scan.pose else { return };
        let sweep = scan.sweep();
        let step = scan.points.len().div_ceil(OF_EACH_SCAN).max(1);
        let first = self.points.len();
        for at in (0..scan.points.len()).step_by(step) {
            let point = scan.points[at];
            let secs = scan.times.as_ref().and_then(|times| times.get(at)).copied();
            let pose = match (&sweep, secs) {
                (Some(sweep), Some(secs)) if secs.is_finite() => sweep.at(f64::from(secs)),
                (Some(_), _) => continue,
                (None, _) => pose,
            };
            if point.is_finite() && point != Vec3::ZERO {
                self.points.push((
                    pose.transform_point(point.as_dvec3()),
                    SurfacePoint::seen(Vec3::ZERO, point),
                ));
            }
        }
        let mut ranges: Vec<f64> = self.points[first..]
            .iter()
            .map(|(p, _)| p.distance(pose.translation))
            .collect();
        if !ranges.is_empty() {
            let middle = ranges.len() / 2;
            let (_, median, _) = ranges.select_nth_unstable_by(middle, f64::total_cmp);
            self.ranges += *median;
            self.scans += 1;
        }
    }

    /// How far the sensor sees, as a rule: the mean of the scans' median ranges, metres.
    pub(crate) fn range_m(&self) -> f64 {
        self.ranges / self.scans.max(1) as f64
    }

    /// The local map in the frame of a pose. If few of its points lie on surfaces, as with few beams, those of the one before are in it, too.
    pub(crate) fn take(&mut self, frame: &Pose) -> LocalMap {
        let to_frame = frame.inverse();
        let map = |points: &mut dyn Iterator<Item = &(DVec3, SurfacePoint)>| {
            let points = points.map(|(at, point)| point.moved(to_frame.transform_point(*at).as_vec3()));
            LocalMap::new(&points.collect::<Vec<_>>())
        };
        let Self { points, before, .. } = std::mem::take(self);
        let mut taken = map(&mut points.iter());
        if (taken.telling as f64) < SPARSE * taken.points.len() as f64 {
            taken = map(&mut before.iter().chain(&points));
        }
        self.before = points;
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_room_that_leans_is_turned_upright() {
        let lean = DQuat::from_scaled_axis(DVec3::new(0.2, -0.15, 0.0));
        let mut points = Vec::new();
        for i in 0..40 {
            for j in 0..40 {
                let (a, b) = (f64::from(i) * 0.15, f64::from(j) * 0.15);
                for p in [
                    DVec3::new(a, b, 0.0),
                    DVec3::new(a, 0.0, 0.5 * b),
                    DVec3::new(0.0, a, 0.5 * b),
                ] {
                    points.push(SurfacePoint::known((lean * p).as_vec3()));
                }
            }
        }
        let map = LocalMap::new(&points);
        let up = map.level() * lean * DVec3::Z;
        assert!(up.angle_between(DVec3::Z) < 0.01, "{up}");
    }
}
