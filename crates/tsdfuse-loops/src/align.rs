//! Maps of several drives in one frame.

use glam::DVec3;
use tsdfuse::Pose;
use tsdfuse_odometry::{OdometryConfig, SurfacePoint, Surfaces};

use crate::graph::between;
use crate::local_map::LocalMap;
use crate::places::Places;

/// From one local map along the way to the next, metres.
const STEP_M: f64 = 4.0;

/// How far a local map reaches, metres.
const REACH_M: f64 = 15.0;

/// Two places say the same of how maps lie to each other if they are nearer than this: metres and radians.
const SAME: (f64, f64) = (0.3, 0.05);

/// Places that must say the same.
const LEAST_VOTES: usize = 3;

/// Places that say something else are at most this share of those that agree.
const CONTRADICTING: f64 = 0.5;

/// Points with which the second map is registered as a whole.
const REGISTERED: usize = 60_000;

/// A map: its surface, and where it was seen from.
#[derive(Clone, Debug, Default)]
pub struct Mapped {
    /// Points of the surface, some 5 to 20 cm apart, metres.
    pub surface: Vec<DVec3>,
    /// Poses of the sensor along its way, z roughly upwards in the world.
    pub poses: Vec<Pose>,
}

/// How two maps lie to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// `first_from_second`.
    pub pose: Pose,
    /// Places along the second map's way that were looked for.
    pub places: usize,
    /// Of these, those that were recognised and agree.
    pub agreeing: usize,
    /// Those that were recognised, and say something else.
    pub contradicting: usize,
    /// Root mean square of the distances of the second map's points from the first one's surfaces, where both have some, metres.
    pub rms_m: f64,
    /// Share of the second map's points that lie where the first has surfaces.
    pub common: f64,
}

/// Brings a map into the frame of another one, with nothing known of how they lie to each other: places along the way of the second are looked for in the
/// first, and what most of them say is refined by registering the whole. `None` if too few places are recognised, or if they disagree.
pub fn align(first: &Mapped, second: &Mapped) -> Option<Alignment> {
    let mut places = Places::default();
    let known = local_maps(first);
    let frames: Vec<Pose> = known.iter().map(|(frame, _)| *frame).collect();
    for (_, map) in known {
        places.add(map);
    }
    let views = local_maps(second);
    let mut told = Vec::new();
    for (view, (frame, map)) in views.iter().enumerate() {
        // The best place for each motion that a view knows of.
        let found = places.find(map, 0..frames.len());
        told.extend(
            found
                .iter()
                .map(|found| (view, frames[found.place] * found.pose * frame.inverse())),
        );
    }
    // How views agree: by where they put the view itself.
    let is_same = |a: &(usize, Pose), b: &(usize, Pose)| {
        let frame = views[b.0].0;
        let off = between(&(a.1 * frame), &(b.1 * frame));
        off.fixed_rows::<3>(0).norm() < SAME.0 && off.fixed_rows::<3>(3).norm() < SAME.1
    };
    let voters = |told_by: &(usize, Pose), agrees: bool| {
        let mut voters: Vec<usize> = Vec::new();
        for other in told.iter().filter(|other| is_same(told_by, other) == agrees) {
            if voters.last() != Some(&other.0) {
                voters.push(other.0);
            }
        }
        voters
    };
    let mut best: Option<(usize, Pose)> = None;
    for told_by in &told {
        let votes = voters(told_by, true).len();
        if best.is_none_or(|(most, _)| votes > most) {
            best = Some((votes, told_by.1));
        }
    }
    let (agreeing, rough) = best?;
    let for_it = voters(&(0, rough), true);
    let against = voters(&(0, rough), false);
    let contradicting = against.iter().filter(|view| !for_it.contains(view)).count();
    let wanted = LEAST_VOTES.min(views.len());
    if agreeing < wanted || contradicting as f64 > CONTRADICTING * agreeing as f64 {
        return None;
    }
    let whole = registered(first, second, &rough);
    Some(Alignment {
        places: views.len(),
        agreeing,
        contradicting,
        ..whole
    })
}

/// The surface around points along the way, each in a frame that only is elsewhere.
fn local_maps(mapped: &Mapped) -> Vec<(Pose, LocalMap)> {
    let mut maps = Vec::new();
    let (mut last, mut along): (Option<DVec3>, f64) = (None, STEP_M);
    for pose in &mapped.poses {
        along += last.map_or(0.0, |last| last.distance(pose.translation));
        last = Some(pose.translation);
        if along < STEP_M {
            continue;
        }
        along = 0.0;
        let frame = Pose {
            translation: pose.translation,
            ..Pose::IDENTITY
        };
        let near = mapped.surface.iter().filter(|p| p.distance(pose.translation) < REACH_M);
        let points = near.map(|p| SurfacePoint::known((*p - pose.translation).as_vec3()));
        maps.push((frame, LocalMap::new(&points.collect::<Vec<_>>())));
    }
    maps
}

/// Registers the whole second map to the first.
fn registered(first: &Mapped, second: &Mapped, rough: &Pose) -> Alignment {
    let origin = first.poses.first().map_or(DVec3::ZERO, |pose| pose.translation);
    let at_origin = Pose {
        translation: origin,
        ..Pose::IDENTITY
    };
    let known = first
        .surface
        .iter()
        .map(|p| SurfacePoint::known((*p - origin).as_vec3()));
    let surfaces = Surfaces::new(&known.collect::<Vec<_>>(), &OdometryConfig::default());
    let middle = second
        .poses
        .get(second.poses.len() / 2)
        .map_or(DVec3::ZERO, |pose| pose.translation);
    let at_middle = Pose {
        translation: middle,
        ..Pose::IDENTITY
    };
    let step = second.surface.len().div_ceil(REGISTERED).max(1);
    let points = second.surface.iter().step_by(step);
    let points: Vec<SurfacePoint> = points.map(|p| SurfacePoint::known((*p - middle).as_vec3())).collect();
    let fit = surfaces.register(&points, &(at_origin.inverse() * *rough * at_middle), 2.0 * SAME.0);
    let (_, common) = surfaces.overlap(&points, &fit.pose);
    Alignment {
        pose: at_origin * fit.pose * at_middle.inverse(),
        places: 0,
        agreeing: 0,
        contradicting: 0,
        rms_m: fit.quality.rms_m,
        common,
    }
}
