//! The frames of a recording, and how they move in each other: what tf messages tell.

use std::collections::BTreeMap;

use tsdfuse::pose::Interpolation;
use tsdfuse::{Pose, Trajectory};

/// The way from a frame to one of its ancestors is this long at most.
const MAX_WAY: usize = 64;

/// How a frame sits in its parent.
#[derive(Clone, Debug, Default)]
struct Edge {
    parent: String,
    /// `parent_from_child` over time; a single one with [`Edge::is_static`].
    poses: BTreeMap<i64, Pose>,
    is_static: bool,
}

/// A tree of frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Frames {
    /// By the name of the child.
    edges: BTreeMap<String, Edge>,
    /// Frames that were told of with two parents.
    pub(crate) torn: Vec<String>,
}

/// Poses in order of time with interpolated ones in gaps of up to an hour.
pub(crate) fn filled(poses: &[(i64, Pose)], step_ns: i64) -> Vec<(i64, Pose)> {
    const LONGEST_NS: i64 = 3_600_000_000_000;
    let mut all = Vec::new();
    for pair in poses.windows(2) {
        let [(begin, from), (end, to)] = [pair[0], pair[1]];
        all.push((begin, from));
        let gap = end.saturating_sub(begin);
        if gap > step_ns && gap <= LONGEST_NS {
            let between = Interpolation::new(from, to);
            let steps = gap / step_ns;
            all.extend((1..=steps).filter_map(|k| {
                let time_ns = begin + k * step_ns;
                (time_ns < end).then(|| (time_ns, between.at(k as f64 * step_ns as f64 / gap as f64)))
            }));
        }
    }
    all.extend(poses.last());
    all
}

/// Names of frames may begin with a slash, which means nothing.
pub(crate) fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

impl Frames {
    /// Takes in where `child` is in `parent` at a time. The first parent of a frame stays its parent.
    pub(crate) fn add(&mut self, parent: &str, child: &str, time_ns: i64, pose: Pose, is_static: bool) {
        let (parent, child) = (plain(parent), plain(child));
        let edge = self.edges.entry(child.to_owned()).or_insert_with(|| Edge {
            parent: parent.to_owned(),
            poses: BTreeMap::new(),
            is_static,
        });
        if edge.parent != parent {
            if !self.torn.iter().any(|frame| frame == child) {
                self.torn.push(child.to_owned());
            }
            return;
        }
        if is_static {
            edge.poses.clear();
        }
        edge.poses.insert(time_ns, pose);
    }

    /// Frames that are published again and again without moving are static.
    pub(crate) fn settle(&mut self) {
        for edge in self.edges.values_mut() {
            let mut poses = edge.poses.values();
            if let Some(first) = poses.next() {
                edge.is_static |= poses.all(|pose| pose == first);
            }
        }
    }

    /// Fills gaps between the poses of moving frames with interpolated ones.
    pub(crate) fn fill(&mut self, step_ns: i64) {
        for edge in self.edges.values_mut().filter(|edge| !edge.is_static) {
            let poses: Vec<_> = edge.poses.iter().map(|(time_ns, pose)| (*time_ns, *pose)).collect();
            edge.poses = filled(&poses, step_ns).into_iter().collect();
        }
    }

    /// Changes the time of each pose.
    pub(crate) fn shift(&mut self, time: impl Fn(i64) -> i64) {
        for edge in self.edges.values_mut() {
            edge.poses = edge.poses.iter().map(|(t, pose)| (time(*t), *pose)).collect();
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// A frame, its parent, the parent's parent and so on.
    ///
    /// # Errors
    /// Names the frames that go round in a circle.
    pub(crate) fn way_up(&self, frame: &str) -> Result<Vec<String>, String> {
        let mut way = vec![plain(frame).to_owned()];
        while let Some(edge) = way.last().and_then(|last| self.edges.get(last)) {
            if way.contains(&edge.parent) {
                return Err(format!(
                    "the frames of tf go round in a circle: {} → {}",
                    way.join(" → "),
                    edge.parent
                ));
            }
            way.push(edge.parent.clone());
            if way.len() > MAX_WAY {
                return Err(format!("the frames of tf are nested more than {MAX_WAY} deep"));
            }
        }
        Ok(way)
    }

    fn is_static(&self, child: &str) -> bool {
        self.edges.get(child).is_some_and(|edge| edge.is_static)
    }

    /// The highest frame that `frame` is fixed to, and `that_from_frame`.
    pub(crate) fn body(&self, frame: &str) -> Result<(String, Pose), String> {
        let (mut pose, mut body) = (Pose::IDENTITY, plain(frame).to_owned());
        for child in self.way_up(frame)? {
            body.clone_from(&child);
            match self.edges.get(&child) {
                Some(edge) if edge.is_static => {
                    pose = edge.poses.values().next_back().copied().unwrap_or_default() * pose;
                }
                _ => break,
            }
        }
        Ok((body, pose))
    }

    /// `to_from_frame`, if no frame between them moves.
    pub(crate) fn between(&self, to: &str, frame: &str) -> Option<Pose> {
        let (a, up_to) = self.body(to).ok()?;
        let (b, up_frame) = self.body(frame).ok()?;
        if a == b {
            return Some(up_to.inverse() * up_frame);
        }
        // One may lie above what the other is fixed to only through static frames; then both have the same body.
        None
    }

    /// The frames above `frame` in which it moves, the highest first.
    pub(crate) fn worlds(&self, frame: &str) -> Result<Vec<String>, String> {
        let way = self.way_up(frame)?;
        let moves_below = |at: usize| way.iter().take(at).any(|child| !self.is_static(child));
        let worlds = way.iter().enumerate().skip(1).filter(|(at, _)| moves_below(*at));
        Ok(worlds.map(|(_, frame)| frame.clone()).rev().collect())
    }

    /// `world_from_frame` over time: at each time at which one of the frames between them was published, while all are known.
    pub(crate) fn trajectory(&self, world: &str, frame: &str) -> Result<Option<Trajectory>, String> {
        let way = self.way_up(frame)?;
        let Some(at) = way.iter().position(|other| other == plain(world)) else {
            return Ok(None);
        };
        let below = way.get(..at).unwrap_or_default();
        let edges: Vec<&Edge> = below.iter().filter_map(|child| self.edges.get(child)).collect();
        let moving = || edges.iter().filter(|edge| !edge.is_static);
        let mut tracks: Vec<(Option<Pose>, Option<Trajectory>)> = Vec::new();
        for edge in &edges {
            if edge.is_static {
                tracks.push((edge.poses.values().next_back().copied(), None));
            } else {
                let poses = edge.poses.iter().map(|(t, pose)| (*t, *pose)).collect();
                tracks.push((None, Some(Trajectory::new(poses).map_err(|e| e.to_string())?)));
            }
        }
        let mut times: Vec<i64> = moving().flat_map(|edge| edge.poses.keys().copied()).collect();
        times.sort_unstable();
        times.dedup();
        let at = |time_ns: i64| {
            tracks.iter().try_fold(Pose::IDENTITY, |pose, (fixed, track)| {
                let parent_from_child = match track {
                    Some(track) => track.at(time_ns)?,
                    None => (*fixed)?,
                };
                Some(parent_from_child * pose)
            })
        };
        let poses: Vec<_> = times.into_iter().filter_map(|t| Some((t, at(t)?))).collect();
        Ok(Trajectory::new(poses).ok())
    }
}

#[cfg(test)]
mod tests {
    use tsdfuse::glam::{DQuat, DVec3};

    use super::*;

    fn at(x: f64, yaw: f64) -> Pose {
        Pose {
            rotation: DQuat::from_rotation_z(yaw),
            translation: DVec3::new(x, 0.0, 0.0),
        }
    }

    fn robot() -> Frames {
        let mut frames = Frames::default();
        frames.add("/base_link", "/velodyne", 0, at(0.5, 0.1), true);
        frames.add("base_link", "front", 0, at(1.0, 0.0), true);
        for k in 0..10 {
            frames.add("odom", "base_link", k * 100, at(k as f64, 0.0), false);
        }
        for k in 0..3 {
            frames.add("map", "odom", k * 400 + 50, at(0.0, 0.1 * k as f64), false);
        }
        frames.settle();
        frames
    }

    #[test]
    fn a_sensor_moves_through_several_frames() {
        let frames = robot();
        assert_eq!(frames.body("velodyne").unwrap(), ("base_link".into(), at(0.5, 0.1)));
        assert_eq!(frames.worlds("/velodyne").unwrap(), ["map", "odom"]);
        let track = frames.trajectory("map", "base_link").unwrap().unwrap();
        assert_eq!(track.span_ns(), (50, 850));
        let want = at(0.0, 0.0375) * at(2.0, 0.0);
        assert!(track.at(200).unwrap().translation.distance(want.translation) < 1e-12);
        let odom = frames.trajectory("odom", "velodyne").unwrap().unwrap();
        assert_eq!(odom.poses().len(), 10);
        assert!((odom.at(900).unwrap().translation.x - 9.5).abs() < 1e-12);
        let front_from_velodyne = frames.between("front", "velodyne").unwrap();
        assert!((front_from_velodyne.translation.x + 0.5).abs() < 1e-12);
        assert_eq!(frames.between("map", "velodyne"), None);
    }

    #[test]
    fn circles_are_refused_and_second_parents_told() {
        let mut frames = robot();
        frames.add("velodyne", "map", 0, at(0.0, 0.0), false);
        let told = frames.trajectory("map", "velodyne").unwrap_err();
        assert_eq!(
            told,
            "the frames of tf go round in a circle: velodyne → base_link → odom → map → velodyne"
        );
        frames.add("other", "odom", 7, at(0.0, 0.0), false);
        assert_eq!(frames.torn, ["odom"]);
    }
}
