//! Places: local maps that are known, among which another one is looked for.

use glam::{DQuat, DVec3};
use nalgebra::Matrix6;
use rustc_hash::FxHashMap;
use tsdfuse::Pose;
use tsdfuse_odometry::{SurfacePoint, Surfaces};

use crate::features::{Features, PIXEL_M};
use crate::graph::{between, right};
use crate::local_map::LocalMap;

/// How far surfaces are looked for at first: metres.
const REACH_M: f64 = 1.5;

/// Of the points that tell a surface in their own map, the share that lies where the other map has one, at least, from each of the two to the other.
const LEAST_COMMON: f64 = 0.4;

/// The share of these that lie on the surfaces as well as noise allows, at least.
const LEAST_ON: f64 = 0.75;

/// How far surfaces are looked for when the place is registered to the view, metres.
const BACK_M: f64 = 0.5;

/// How far this may come out from where the view was registered to the place, metres and radians.
const MOST_APART: (f64, f64) = (0.05, 0.01);

/// Standard deviation of the position along its worst direction at most, metres.
const LEAST_KNOWN_M: f64 = 0.05;

/// What two local maps may be distorted within themselves, metres and radians: this is added to what registration says of itself, as is how far its two
/// directions are apart.
const DISTORTED: (f64, f64) = (0.01, 0.001);

/// Motions that are tried for each place, and places that are looked at, the most promising ones.
const TRIED: (usize, usize) = (2, 8);

/// Edge of the squares in which heights are compared, metres.
const HEIGHT_M: f64 = 2.0 * PIXEL_M;

/// A place in which a view was recognised.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// Number of the place.
    pub place: usize,
    /// `place_from_view`.
    pub pose: Pose,
    /// Covariance of shift (metres) and turn (radians), along and about the axes of the view.
    pub covariance: Matrix6<f64>,
    /// Whether few points tell the position along some direction, as in a corridor: farther along it all may look the same.
    pub is_weak: bool,
    /// Share of these points that lie on the other's surfaces, of those near them: the smaller one of view and place.
    pub matched: f64,
    /// Share of the points on surfaces that are near the other's surfaces: the smaller one of view and place.
    pub common: f64,
    /// Root mean square of the distances of matched points from the surfaces, metres.
    pub rms_m: f64,
    /// The same of all points at the pose from which registration started, as far as they were nearer than 1.5 m.
    pub rms_before_m: f64,
}

/// Local maps that are known, and what finds others among them.
#[derive(Default)]
pub struct Places {
    places: Vec<Place>,
}

struct Place {
    map: LocalMap,
    features: Option<Features>,
}

impl Places {
    /// Adds a local map; its number.
    pub fn add(&mut self, map: LocalMap) -> usize {
        self.places.push(Place { map, features: None });
        self.places.len() - 1
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// The local map of a place.
    pub fn map(&self, place: usize) -> Option<&LocalMap> {
        self.places.get(place).map(|place| &place.map)
    }

    /// Verifies that a view was taken at a place, at a pose (`place_from_view`) that is roughly known: both are registered, and must see the same
    /// surfaces.
    pub fn verify(&self, view: &LocalMap, place: usize, rough: &Pose) -> Option<Found> {
        let known = &self.places.get(place)?.map;
        verified(view, &view.surfaces(), place, known, &known.surfaces(), rough)
    }

    /// Looks for a view among places, without any idea where it is: what was verified, the best one first.
    ///
    /// Seen from above, walls, poles and cars make corners; places with many corners alike, which agree on how both lie to each other, are verified
    /// by registration.
    pub fn find(&mut self, view: &LocalMap, among: impl IntoIterator<Item = usize>) -> Vec<Found> {
        let features = Features::of(view);
        let mut candidates = Vec::new();
        for place in among {
            let Some(known) = self.places.get_mut(place) else {
                continue;
            };
            let theirs = known.features.get_or_insert_with(|| Features::of(&known.map));
            let motions = features.place_in(theirs, TRIED.0);
            candidates.extend(motions.into_iter().map(|motion| (motion, place)));
        }
        candidates.sort_by(|a, b| b.0.inliers.cmp(&a.0.inliers).then(a.1.cmp(&b.1)));
        candidates.truncate(TRIED.1);
        let surfaces = view.surfaces();
        let mut found: Vec<Found> = candidates
            .into_iter()
            .filter_map(|(motion, place)| {
                let known = &self.places[place].map;
                let level = Pose {
                    rotation: DQuat::from_rotation_z(motion.turn),
                    translation: motion.shift.extend(0.0),
                };
                let height = height_between(view, known, &level)?;
                let levelled = Pose {
                    translation: level.translation + DVec3::Z * height,
                    ..level
                };
                let rough = turned(known.level().conjugate()) * levelled * turned(view.level());
                verified(view, &surfaces, place, known, &known.surfaces(), &rough)
            })
            .collect();
        found.sort_by(|a, b| (b.common * b.matched).total_cmp(&(a.common * a.matched)));
        found
    }
}

fn turned(rotation: DQuat) -> Pose {
    Pose {
        rotation,
        ..Pose::IDENTITY
    }
}

/// How much higher a known map lies than a view, once both are levelled and the view is moved in the plane: the median over squares of what is
/// lowest in each.
fn height_between(view: &LocalMap, known: &LocalMap, level: &Pose) -> Option<f64> {
    let lowest = |map: &LocalMap, by: &Pose| {
        let mut lowest: FxHashMap<(i32, i32), f64> = FxHashMap::default();
        for p in map.points() {
            let p = by.transform_point(map.level() * p.at.as_dvec3());
            let square = ((p.x / HEIGHT_M).floor() as i32, (p.y / HEIGHT_M).floor() as i32);
            lowest.entry(square).and_modify(|z| *z = z.min(p.z)).or_insert(p.z);
        }
        lowest
    };
    let (own, theirs) = (lowest(view, level), lowest(known, &Pose::IDENTITY));
    let mut differences: Vec<f64> = own
        .iter()
        .filter_map(|(square, z)| Some(theirs.get(square)? - z))
        .collect();
    if differences.is_empty() {
        return None;
    }
    let middle = differences.len() / 2;
    Some(*differences.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Registers a view to a place, and checks that both see the same.
fn verified(
    view: &LocalMap,
    view_surfaces: &Surfaces,
    place: usize,
    known: &LocalMap,
    known_surfaces: &Surfaces,
    rough: &Pose,
) -> Option<Found> {
    let fit = known_surfaces.register(view.points(), rough, REACH_M);
    let (on, near) = known_surfaces.overlap(view.telling(), &fit.pose);
    let (on_back, near_back) = view_surfaces.overlap(known.telling(), &fit.pose.inverse());
    let matched = (on / near.max(1e-9)).min(on_back / near_back.max(1e-9));
    let common = near.min(near_back);
    let is_known = fit.quality.position_sigma_m <= LEAST_KNOWN_M;
    if !is_known || common < LEAST_COMMON || matched < LEAST_ON {
        return None;
    }
    // The place registered to the view: where there is a false minimum, the other way round leads out of it.
    let back = view_surfaces.register(known.points(), &fit.pose.inverse(), BACK_M).pose;
    let apart = between(&fit.pose, &back.inverse());
    let (shift, turn) = (apart.fixed_rows::<3>(0).norm(), apart.fixed_rows::<3>(3).norm());
    if shift > MOST_APART.0 || turn > MOST_APART.1 {
        return None;
    }
    let (shift, turn) = (shift.hypot(DISTORTED.0), turn.hypot(DISTORTED.1));
    let floor = [shift, shift, shift, turn, turn, turn].map(|sigma: f64| sigma * sigma);
    let covariance = right(&fit.information, fit.pose.rotation).try_inverse()? + Matrix6::from_diagonal(&floor.into());
    Some(Found {
        place,
        pose: fit.pose,
        covariance,
        is_weak: fit.is_weak,
        matched,
        common,
        rms_m: fit.quality.rms_m,
        rms_before_m: rms(known_surfaces, view.points(), rough),
    })
}

/// Root mean square distance of points from the surfaces around them, at most [`REACH_M`].
fn rms(surfaces: &Surfaces, points: &[SurfacePoint], pose: &Pose) -> f64 {
    let (mut sum, mut n) = (0.0, 0_usize);
    for r in points
        .iter()
        .filter_map(|p| surfaces.distance(pose.transform_point(p.at.as_dvec3())))
    {
        if r.abs() < REACH_M {
            (sum, n) = (sum + r * r, n + 1);
        }
    }
    if n == 0 { REACH_M } else { (sum / n as f64).sqrt() }
}
