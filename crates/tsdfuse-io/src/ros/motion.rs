//! Where the poses of a recording come from: tf, odometry, stamped poses and paths, and which of them is used.

use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Trajectory};

use super::frames::{Frames, filled, plain};
use crate::poses;

/// Poses over time from one topic.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    pub(crate) topic: String,
    /// `nav_msgs/Odometry`, …
    pub(crate) kind: String,
    /// The frame in which the poses are.
    pub(crate) world: String,
    /// The frame whose poses they are; empty where the messages do not tell.
    pub(crate) body: String,
    pub(crate) poses: Vec<(i64, Pose)>,
    /// How much later the messages were recorded than they are stamped, seconds.
    pub(crate) delay_secs: Option<f64>,
}

impl Track {
    /// Fills gaps with interpolated poses.
    pub(crate) fn fill(&mut self, step_ns: i64) {
        self.poses.sort_by_key(|(time_ns, _)| *time_ns);
        self.poses = filled(&self.poses, step_ns);
    }
}

/// Poses that could be those of a sensor.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    /// What `--poses` calls it: a topic, or a frame of tf.
    pub(crate) name: String,
    /// With the way of frames.
    pub(crate) what: String,
    /// `world_from_body`.
    pub(crate) trajectory: Trajectory,
    pub(crate) body: String,
    pub(crate) body_from_sensor: Pose,
    /// What had to be assumed.
    pub(crate) assumed: Option<String>,
    /// Of two that cover the same, the smaller one.
    rank: usize,
    /// The part of the scans that have a pose.
    pub(crate) covers: f64,
    /// The length of its way, metres.
    pub(crate) length_m: f64,
}

/// Shorter ways are noise.
const MOVES_M: f64 = 0.1;
/// More turn than this is motion, radians.
const TURNS_RAD: f64 = 0.02;

impl Candidate {
    fn moves(&self) -> bool {
        let first = self.trajectory.poses().first().copied().unwrap_or_default();
        let far = |pose: &Pose| {
            pose.translation.distance(first.translation) > MOVES_M
                || pose.rotation.angle_between(first.rotation) > TURNS_RAD
        };
        self.trajectory.poses().iter().any(far)
    }

    /// What is known of it, for people.
    pub(crate) fn line(&self, is_used: bool) -> String {
        let rate = rate_hz(self.trajectory.times_ns());
        format!(
            "{}{}: {} poses{}, {:.1} m, for {:.0} % of the scans",
            if is_used { "used: " } else { "" },
            self.what,
            self.trajectory.poses().len(),
            rate.map_or(String::new(), |rate| format!(" at {rate:.1} Hz")),
            self.length_m,
            100.0 * self.covers
        )
    }
}

/// The rate of most steps.
pub(crate) fn rate_hz(times_ns: &[i64]) -> Option<f64> {
    let mut steps: Vec<f64> = times_ns.windows(2).map(|pair| secs_between(pair[0], pair[1])).collect();
    let median = super::point_times::median(&mut steps);
    (median > 0.0).then(|| 1.0 / median)
}

/// All poses that could be those of a sensor whose scans are in `frame` at `times_ns`, the best first.
///
/// # Errors
/// If frames of tf go round in a circle.
pub(crate) fn candidates(
    frames: &Frames,
    tracks: &[Track],
    frame: &str,
    times_ns: &[i64],
) -> Result<Vec<Candidate>, String> {
    let (body, body_from_sensor) = frames.body(frame)?;
    let mut all = Vec::new();
    for (rank, world) in frames.worlds(frame)?.into_iter().enumerate() {
        if let Some(trajectory) = frames.trajectory(&world, &body)? {
            let way = frames.way_up(frame)?;
            let way: Vec<_> = way
                .iter()
                .rev()
                .map(String::as_str)
                .skip_while(|name| *name != world)
                .collect();
            all.push(Candidate {
                what: format!("tf {}", way.join(" → ")),
                name: world,
                trajectory,
                body: body.clone(),
                body_from_sensor,
                assumed: None,
                rank,
                covers: 0.0,
                length_m: 0.0,
            });
        }
    }
    for track in tracks {
        let mut poses = track.poses.clone();
        poses.sort_by_key(|(time_ns, _)| *time_ns);
        poses.dedup_by_key(|(time_ns, _)| *time_ns);
        let Ok(trajectory) = Trajectory::new(poses) else {
            continue;
        };
        let (their_body, body_from_sensor, assumed) = sitting(frames, track, frame, &body, body_from_sensor);
        all.push(Candidate {
            name: track.topic.clone(),
            what: format!("{} ({})", track.topic, track.kind),
            trajectory,
            body: their_body,
            body_from_sensor,
            rank: match track.kind.as_str() {
                "nav_msgs/Odometry" => 100,
                "nav_msgs/Path" => 102,
                _ => 101,
            } + if assumed.is_some() { 50 } else { 0 },
            assumed,
            covers: 0.0,
            length_m: 0.0,
        });
    }
    for candidate in &mut all {
        let covered = times_ns
            .iter()
            .filter(|&&t| poses::at(&candidate.trajectory, t).is_ok())
            .count();
        candidate.covers = covered as f64 / times_ns.len().max(1) as f64;
        candidate.length_m = candidate.trajectory.length_m();
    }
    // Those that move first; of them, those that cover more, in steps of 5 %.
    let order = |c: &Candidate| (!c.moves(), -(c.covers * 20.0).round() as i64, c.rank);
    all.sort_by_key(order);
    Ok(all)
}

/// The body whose poses a track has, where the sensor sits on it, and what is assumed for that.
fn sitting(frames: &Frames, track: &Track, frame: &str, body: &str, on_body: Pose) -> (String, Pose, Option<String>) {
    let (theirs, frame) = (plain(&track.body), plain(frame));
    if theirs == frame {
        return (frame.to_owned(), Pose::IDENTITY, None);
    }
    if let Some(pose) = frames.between(theirs, frame).filter(|_| !theirs.is_empty()) {
        return (theirs.to_owned(), pose, None);
    }
    if theirs.is_empty() && body != frame {
        let assumed = format!(
            "the poses of {} do not tell whose they are: they are taken as those of {body}",
            track.topic
        );
        return (body.to_owned(), on_body, Some(assumed));
    }
    let whose = if theirs.is_empty() {
        "do not tell whose they are".to_owned()
    } else {
        format!("are those of {theirs}")
    };
    let assumed = format!(
        "the poses of {} {whose}, and no static tf tells where {frame} sits on it: they are taken as the sensor's own; \
         --extrinsics would tell",
        track.topic
    );
    (frame.to_owned(), Pose::IDENTITY, Some(assumed))
}

#[cfg(test)]
mod tests {
    use tsdfuse::glam::DVec3;

    use super::*;

    fn at(x: f64) -> Pose {
        Pose {
            translation: DVec3::new(x, 0.0, 0.0),
            ..Pose::IDENTITY
        }
    }

    fn track(topic: &str, body: &str, until: i64, speed: f64) -> Track {
        Track {
            topic: topic.into(),
            kind: "nav_msgs/Odometry".into(),
            world: "odom".into(),
            body: body.into(),
            poses: (0..=until).map(|k| (k * 100_000_000, at(k as f64 * speed))).collect(),
            delay_secs: None,
        }
    }

    #[test]
    fn what_moves_and_covers_the_scans_is_used() {
        let mut frames = Frames::default();
        frames.add("base", "lidar", 0, at(0.5), true);
        frames.settle();
        let tracks = [
            track("/still", "base", 100, 0.0),
            track("/short", "base", 40, 1.0),
            track("/odom", "base", 100, 1.0),
        ];
        let times: Vec<i64> = (0..100).map(|k| k * 100_000_000).collect();
        let found = candidates(&frames, &tracks, "lidar", &times).unwrap();
        let names: Vec<_> = found.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["/odom", "/short", "/still"]);
        assert_eq!(
            (found[0].covers, found[0].body_from_sensor, &found[0].assumed),
            (1.0, at(0.5), &None)
        );
        assert!((found[1].covers - 0.41).abs() < 1e-12);
        // tf that does as well goes before odometry.
        for k in 0..=100 {
            frames.add("odom", "base", k * 100_000_000, at(k as f64), false);
        }
        assert_eq!(candidates(&frames, &tracks, "lidar", &times).unwrap()[0].name, "odom");
    }

    #[test]
    fn what_is_assumed_is_told() {
        let found = candidates(&Frames::default(), &[track("/odom", "base", 9, 1.0)], "lidar", &[0]).unwrap();
        let assumed = found[0].assumed.clone().unwrap();
        assert!(
            assumed.contains("are those of base, and no static tf tells where lidar sits on it"),
            "{assumed}"
        );
        assert_eq!(found[0].body_from_sensor, Pose::IDENTITY);
    }
}
