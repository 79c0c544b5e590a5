//! Where a sensor is in a world that was seen before: many poses are tried, the best ones are registered, and one is believed if it is far
//! better than all that lie elsewhere.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use nalgebra::Matrix6;
use rayon::prelude::*;
use tsdfuse::Pose;

use crate::cells::Cells;
use crate::motion::{Motion, turn_of};
use crate::register::{Prior, Registered, register};
use crate::returns::{KERNEL, Return, kernel};

/// Returns by which a pose is judged before it is registered.
const JUDGES: usize = 300;

/// Width of the kernel then, metres: poses are tried about as far apart.
const WIDTH: f64 = 0.4;

/// Poses that are registered.
const BEST: usize = 24;

/// A place is believed if such a share of the returns lies on what was seen.
const LEAST_MATCHED: f64 = 0.5;

/// Another place that has more than this share of the matches of the best one makes it doubtful.
const DOUBTFUL: f64 = 0.8;

/// Poses that lie nearer together than this are the same place, metres and radians.
const SAME: (f64, f64) = (0.5, 0.1);

/// Where a sensor is sought.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Search {
    /// Near these poses: up to 3.5 m away, turned by up to 30°.
    pub near: Vec<Pose>,
    /// Along these poses, of a trajectory: up to 5 m beside it, turned in any way about the sensor's own z axis.
    pub along: Vec<Pose>,
}

/// Poses around one, in its frame: shifts forward, to the left and upwards, metres, and turns about its z axis, radians.
struct Around {
    forward: Vec<f64>,
    left: Vec<f64>,
    up: Vec<f64>,
    turns: Vec<f64>,
}

impl Around {
    fn of(&self, pose: Pose) -> impl Iterator<Item = Pose> + '_ {
        let shifts = self
            .forward
            .iter()
            .flat_map(|&x| self.left.iter().map(move |&y| (x, y)));
        let shifts = shifts.flat_map(|(x, y)| self.up.iter().map(move |&z| DVec3::new(x, y, z)));
        shifts.flat_map(move |shift| {
            self.turns.iter().map(move |&turn| Pose {
                rotation: pose.rotation * DQuat::from_rotation_z(turn),
                translation: pose.transform_point(shift),
            })
        })
    }
}

/// `-n` to `n` steps.
fn steps(n: i32, step: f64) -> Vec<f64> {
    (-n..=n).map(|i| f64::from(i) * step).collect()
}

/// The poses `world_from_sensor` that are tried.
fn tried(search: &Search) -> Vec<Pose> {
    let near = Around {
        forward: steps(5, 0.7),
        left: steps(5, 0.7),
        up: steps(1, 0.6),
        turns: steps(6, 5_f64.to_radians()),
    };
    let along = Around {
        forward: vec![0.0],
        left: steps(5, 1.0),
        up: vec![0.0],
        turns: (0..60).map(|i| f64::from(i) * TAU / 60.0).collect(),
    };
    let mut all: Vec<Pose> = search.near.iter().flat_map(|pose| near.of(*pose)).collect();
    let mut last: Option<DVec3> = None;
    for pose in &search.along {
        if last.is_none_or(|last| last.distance(pose.translation) > 1.0) {
            last = Some(pose.translation);
            all.extend(along.of(*pose));
        }
    }
    all
}

/// Where the sensor was at the begin of a sweep whose motion, from its begin on, is known; `None` where no place fits, or several do.
pub(crate) fn locate(
    cells: &Cells,
    sparse: &[Return],
    dense: &[Return],
    motion: &Motion,
    search: &Search,
) -> Option<Registered> {
    let placer = motion.placer();
    let step = sparse.len().div_ceil(JUDGES).max(1);
    let back = motion.first().inverse();
    let judges = sparse.iter().step_by(step);
    let judges: Vec<DVec3> = judges
        .map(|r| back.transform_point(placer.place(r.point, r.share)))
        .collect();
    let mut judged: Vec<(f64, Pose)> = tried(search)
        .into_par_iter()
        .map(|pose| (judge(cells, &judges, &pose), pose))
        .collect();
    // Stable, so that the order of poses decides between equal ones.
    judged.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut best: Vec<Pose> = Vec::new();
    for (_, pose) in judged {
        if best.len() == BEST {
            break;
        }
        if !best.iter().any(|other| is_same(other, &pose)) {
            best.push(pose);
        }
    }
    let mut placed: Vec<Registered> = best
        .iter()
        .map(|pose| placed_at(cells, sparse, dense, motion, pose))
        .collect();
    placed.sort_by(|a, b| b.matched.total_cmp(&a.matched));
    let first = placed.first()?;
    let elsewhere = placed
        .iter()
        .find(|other| !is_same(&other.motion.first(), &first.motion.first()));
    let is_clear = elsewhere.is_none_or(|other| other.matched < DOUBTFUL * first.matched);
    (first.matched > LEAST_MATCHED && is_clear).then(|| first.clone())
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    a.translation.distance(b.translation) < SAME.0 && turn_of(a.rotation.conjugate() * b.rotation).length() < SAME.1
}

/// How many returns lie near what was seen.
fn judge(cells: &Cells, judges: &[DVec3], pose: &Pose) -> f64 {
    let near = judges.iter().filter_map(|p| {
        let (_, r, variance) = cells.plane_at(pose.transform_point(*p))?;
        Some(kernel(r, KERNEL * KERNEL * variance + WIDTH * WIDTH))
    });
    near.sum()
}

/// A sweep registered from a pose on that is roughly known.
fn placed_at(cells: &Cells, sparse: &[Return], dense: &[Return], motion: &Motion, pose: &Pose) -> Registered {
    let to_pose = *pose * motion.first().inverse();
    let mut prior = Prior {
        motion: motion.moved(&to_pose),
        begin: Matrix6::from_diagonal(&[1.0, 1.0, 1.0, 10.0, 10.0, 10.0].into()),
        step_sigma: (0.02, 0.005),
        most: (0.02, 0.005),
        remembered: None,
        along: None,
        reach: 1.5,
    };
    // From afar, then from nearby with the planes that lie there.
    let far = register(cells, sparse, dense, &prior);
    prior.motion = far.motion;
    prior.reach = 0.3;
    register(cells, sparse, dense, &prior)
}
