//! A recording as a log: which sensors are read, where they were, and what else was recorded.

use std::path::Path;

use tsdfuse::glam::DVec3;
use tsdfuse::scan::PoseAt;
use tsdfuse::sensor::Pinhole;
use tsdfuse::trajectory::{ns_after, secs_between};
use tsdfuse::{Pose, STANDARD_GRAVITY, Scan, Trajectory};

use super::bag::Bag;
use super::container::{Channel, Entry};
use super::images;
use super::lidar::Lidar;
use super::messages;
use super::motion::{self, Candidate, Track};
use super::packets::PacketSweeps;
use super::survey::{Stamps, Survey, Use, use_of, with_message};
use crate::calibrations::Calibrations;
use crate::error::{Error, Result};
use crate::placed;
use crate::poses::{self, Poses};
use crate::source::{GnssFix, ImageRef, ImuSample, OpenOptions, Recorded, ScanRef, Sensor, Source, Topic};

/// Clocks that differ by more than this are different clocks, seconds.
const SAME_CLOCK_SECS: f64 = 1.0;

/// An opened recording.
pub(crate) struct Recording {
    bag: Bag,
    lidars: Vec<Lidar>,
    sensors: Vec<Sensor>,
    scans: Vec<ScanRef>,
    /// Number of the LiDAR and of its sweep, of each scan.
    places: Vec<(usize, usize)>,
    trajectory: Option<Trajectory>,
    imu: Option<Inertial>,
    /// Channels of GNSS receivers, and where their antennas are in the body frame, if frames tell.
    gnss: Vec<(usize, [f64; 3])>,
    survey: Survey,
    images: Vec<ImageRef>,
    /// Channel and message of each image.
    image_places: Vec<(usize, Entry)>,
    recorded: Recorded,
    notes: Vec<String>,
}

/// An inertial measurement unit.
struct Inertial {
    channel: usize,
    /// The LiDAR in which it is, where messages hold that sensor's packets.
    lidar: Option<usize>,
    /// `body_from_imu`, where frames tell.
    body_from_imu: Option<Pose>,
}

/// Where the poses come from, when it is settled.
struct Motion {
    trajectory: Trajectory,
    /// Where each LiDAR sits on the body.
    body_from_sensor: Vec<Pose>,
    body: String,
}

/// Whether a channel holds packets of a LiDAR's inertial measurement unit.
fn is_imu_packets(channel: &Channel) -> bool {
    use_of(channel) == Use::Packets && channel.topic.contains("imu")
}

impl Recording {
    pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Self> {
        let bag = Bag::open(path)?;
        let survey = Survey::make(&bag, options.glance)?;
        let mut this = Self {
            notes: [bag.notes(), &survey.notes].concat(),
            bag,
            lidars: Vec::new(),
            sensors: Vec::new(),
            scans: Vec::new(),
            places: Vec::new(),
            trajectory: None,
            imu: None,
            gnss: Vec::new(),
            survey,
            images: Vec::new(),
            image_places: Vec::new(),
            recorded: Recorded::default(),
        };
        let all = this.look_at_lidars(path, options)?;
        let chosen = this.choose(path, all, options)?;
        this.lidars = chosen;
        let motion = this.settle_motion(path, options)?;
        this.make_sensors(path, options, motion.as_ref())?;
        this.make_scans(motion.as_ref());
        this.find_imu(motion.as_ref());
        this.find_images(motion.as_ref());
        this.trajectory = motion.map(|motion| motion.trajectory);
        this.list_topics();
        Ok(this)
    }

    fn conclude(&mut self, subject: &str, text: String) {
        self.recorded.conclusions.push((subject.to_owned(), text));
    }

    fn look_at_lidars(&mut self, path: &Path, options: &OpenOptions) -> Result<Vec<Lidar>> {
        let mut all = self.look_at_packets(path, options)?;
        for (number, channel) in self.bag.channels().iter().enumerate() {
            if use_of(channel) != Use::Points {
                continue;
            }
            let told = self.survey.schemas.get(&number).zip(self.survey.stamps.get(&number));
            let Some((schema, stamps)) = told else { continue };
            match Lidar::look(&self.bag, number, schema, stamps) {
                Ok(lidar) => all.push(lidar),
                Err(error) => self.notes.push(format!("{} is not read: {error}", channel.topic)),
            }
        }
        // The one with the most points first.
        let amount = |lidar: &Lidar| lidar.points * lidar.times_ns.len() as f64;
        all.sort_by(|a, b| amount(b).total_cmp(&amount(a)).then_with(|| a.topic.cmp(&b.topic)));
        Ok(all)
    }

    fn look_at_packets(&mut self, path: &Path, options: &OpenOptions) -> Result<Vec<Lidar>> {
        let mut all = Vec::new();
        let told = match options.sensors.as_slice() {
            [name] => tsdfuse_packets::Sensor::named(name),
            _ => None,
        };
        let calibrations = Calibrations::given_or_beside(options.calibration.as_deref(), path)?;
        for (number, channel) in self.bag.channels().iter().enumerate() {
            let Some(schema) = self
                .survey
                .schemas
                .get(&number)
                .filter(|_| use_of(channel) == Use::Packets)
            else {
                continue;
            };
            // Ouster's driver has a second topic of packets, for its IMU.
            if is_imu_packets(channel) {
                continue;
            }
            let stamps = self.survey.stamps.get(&number);
            let frame = stamps.map_or("os_sensor", |stamps| stamps.frame.as_str());
            let looked = PacketSweeps::index(&self.bag, number, schema, &calibrations, told, options.glance)
                .and_then(|packets| Lidar::of_packets(&self.bag, number, schema, frame, packets));
            match looked {
                Ok(lidar) => all.push(lidar),
                Err(error) => self.notes.push(format!("{} is not read: {error}", channel.topic)),
            }
        }
        Ok(all)
    }

    /// Which of the LiDARs are read.
    fn choose(&mut self, path: &Path, all: Vec<Lidar>, options: &OpenOptions) -> Result<Vec<Lidar>> {
        let is_called = |lidar: &Lidar, name: &str| {
            let plain = |text: &str| text.trim_start_matches('/').to_owned();
            plain(&lidar.topic) == plain(name) || plain(&lidar.frame) == plain(name)
        };
        let mut named = Vec::new();
        for name in &options.sensors {
            match all.iter().find(|lidar| is_called(lidar, name)) {
                Some(lidar) => named.push(lidar.clone()),
                // The model of the only one.
                None if options.sensors.len() == 1
                    && (tsdfuse::sensor::model(name).is_some() || tsdfuse_packets::Sensor::named(name).is_some()) => {}
                None => {
                    let topics: Vec<_> = all.iter().map(|lidar| lidar.topic.as_str()).collect();
                    let reason = format!(
                        "there is no sensor {name:?}; the topics with points are {}",
                        topics.join(", ")
                    );
                    return Err(Error::dataset(path, reason));
                }
            }
        }
        if !named.is_empty() {
            return Ok(named);
        }
        let mut chosen: Vec<Lidar> = Vec::new();
        for lidar in all {
            let Some(main) = chosen.first() else {
                chosen.push(lidar);
                continue;
            };
            let body = |lidar: &Lidar| self.survey.frames.body(&lidar.frame).map(|(body, _)| body);
            let same_frame = chosen.iter().find(|other| other.frame == lidar.frame);
            let why = if let Some(other) = same_frame {
                format!("is in the same frame as {}, and taken to be made from it", other.topic)
            } else if self
                .survey
                .frames
                .worlds(&main.frame)
                .is_ok_and(|worlds| worlds.contains(&lidar.frame))
            {
                "is in a frame in which the sensor moves, and taken to be made from others".to_owned()
            } else if self.survey.frames.is_empty() || body(main) != body(&lidar) {
                format!("where {} sits relative to {} is not told", lidar.frame, main.frame)
            } else {
                chosen.push(lidar);
                continue;
            };
            let note = format!(
                "{} is not read: {why}; --sensor {} would choose it",
                lidar.topic, lidar.topic
            );
            self.notes.push(note);
        }
        if chosen.len() > 1 {
            let topics: Vec<_> = chosen.iter().map(|lidar| lidar.topic.as_str()).collect();
            self.notes
                .push(format!("{} are read together; --sensor chooses", topics.join(", ")));
        }
        Ok(chosen)
    }

    /// Brings poses to the clock of the clouds, if they were stamped by another one.
    fn same_clock(&mut self) {
        let main = self
            .lidars
            .first()
            .and_then(|lidar| self.survey.stamps.get(&lidar.channel));
        let Some(clouds) = main.map(|stamps| stamps.delay_secs.unwrap_or_default()) else {
            return;
        };
        let mut notes = Vec::new();
        for track in &mut self.survey.tracks {
            let Some(shift) = track
                .delay_secs
                .map(|delay| delay - clouds)
                .filter(|d| d.abs() > SAME_CLOCK_SECS)
            else {
                continue;
            };
            track
                .poses
                .iter_mut()
                .for_each(|(time_ns, _)| *time_ns = ns_after(*time_ns, shift));
            notes.push(format!(
                "{}: its clock is {shift:.3} s off that of the points, by when they were recorded; it is corrected",
                track.topic
            ));
        }
        let shift = self
            .survey
            .frames_delay_secs
            .map(|delay| delay - clouds)
            .filter(|d| d.abs() > SAME_CLOCK_SECS);
        if let Some(shift) = shift {
            self.survey.frames.shift(|time_ns| ns_after(time_ns, shift));
            notes.push(format!(
                "tf: its clock is {shift:.3} s off that of the points, by when they were recorded; it is corrected"
            ));
        }
        self.notes.extend(notes);
    }

    fn settle_motion(&mut self, path: &Path, options: &OpenOptions) -> Result<Option<Motion>> {
        self.same_clock();
        let Some(main) = self.lidars.first() else {
            return Ok(None);
        };
        if options.extrinsics.is_some() && self.lidars.len() > 1 {
            let reason = "has several sensors, and extrinsics are those of one: choose it with --sensor";
            return Err(Error::dataset(path, reason));
        }
        let times_ns: Vec<i64> = (0..main.sweeps()).map(|sweep| main.time_ns(sweep)).collect();
        let asked = options.poses.as_deref();
        let circle = |why: String| Error::dataset(path, why);
        let mut found = match asked.filter(|asked| asked.is_file()) {
            Some(file) => vec![self.read_poses(file, main, &times_ns)?],
            None => {
                motion::candidates(&self.survey.frames, &self.survey.tracks, &main.frame, &times_ns).map_err(circle)?
            }
        };
        if let Some(name) = asked
            .filter(|asked| !asked.is_file())
            .map(|asked| asked.to_string_lossy().into_owned())
        {
            let plain = |text: &str| text.trim_start_matches('/').to_owned();
            let exact = found.iter().position(|candidate| candidate.name == name);
            let called = || {
                found
                    .iter()
                    .position(|candidate| plain(&candidate.name) == plain(&name))
            };
            let at = exact.or_else(called).ok_or_else(|| {
                let names: Vec<_> = found.iter().map(|candidate| candidate.name.as_str()).collect();
                let known = if names.is_empty() {
                    "there are none".to_owned()
                } else {
                    format!("there are {}", names.join(", "))
                };
                let reason = format!("{name} is neither a file nor a topic or frame with poses of the sensor: {known}");
                Error::dataset(path, reason)
            })?;
            let chosen = found.remove(at);
            found.insert(0, chosen);
        }
        let is_asked = asked.is_some();
        let is_used = found.first().is_some_and(|best| best.covers > 0.0);
        for (i, candidate) in found.iter().enumerate() {
            let line = candidate.line(i == 0 && is_used);
            self.recorded.conclusions.push(("poses".to_owned(), line));
        }
        let Some(best) = found.into_iter().next().filter(|_| is_used) else {
            if is_asked {
                let reason = "the poses that are asked for cover no scan: their times are others";
                return Err(Error::dataset(path, reason));
            }
            return Ok(None);
        };
        self.notes
            .extend(best.assumed.clone().filter(|_| options.extrinsics.is_none()));
        if !is_asked {
            self.notes.push(format!("poses: {}", best.what));
        }
        Ok(Some(self.on_body(best, options)))
    }

    /// Poses of a file.
    fn read_poses(&self, file: &Path, main: &Lidar, times_ns: &[i64]) -> Result<Candidate> {
        let trajectory = match poses::read(file)? {
            Poses::Timed(trajectory) => trajectory,
            Poses::Listed(poses) if poses.len() == times_ns.len() => {
                let timed = times_ns.iter().copied().zip(poses).collect();
                Trajectory::new(timed).map_err(|e| Error::dataset(file, e.to_string()))?
            }
            Poses::Listed(poses) => {
                let reason = format!("{} poses without times for {} scans", poses.len(), times_ns.len());
                return Err(Error::dataset(file, reason));
            }
        };
        let track = Track {
            topic: file.display().to_string(),
            kind: "file".to_owned(),
            world: String::new(),
            body: main.frame.clone(),
            poses: trajectory
                .times_ns()
                .iter()
                .copied()
                .zip(trajectory.poses().iter().copied())
                .collect(),
            delay_secs: None,
        };
        let frames = super::frames::Frames::default();
        let found = motion::candidates(&frames, &[track], &main.frame, times_ns);
        let found = found.ok().and_then(|found| found.into_iter().next());
        found.ok_or_else(|| Error::dataset(file, "holds no poses"))
    }

    /// The poses with the place of each LiDAR on the body; LiDARs whose place is not known are left out.
    fn on_body(&mut self, best: Candidate, options: &OpenOptions) -> Motion {
        let main_from_body = best.body_from_sensor.inverse();
        let main = self.lidars.first().map_or(String::new(), |lidar| lidar.frame.clone());
        let mut body_from_sensor = Vec::new();
        let mut left_out = Vec::new();
        self.lidars.retain(|lidar| {
            let pose = match options.extrinsics {
                Some(pose) => Some(pose),
                None if lidar.frame == main => Some(best.body_from_sensor),
                None => self
                    .survey
                    .frames
                    .between(&main, &lidar.frame)
                    .map(|main_from_this| main_from_body.inverse() * main_from_this),
            };
            body_from_sensor.extend(pose);
            if pose.is_none() {
                left_out.push(format!(
                    "{} is not read: where {} sits relative to {main} is not told",
                    lidar.topic, lidar.frame
                ));
            }
            pose.is_some()
        });
        self.notes.extend(left_out);
        Motion {
            trajectory: best.trajectory,
            body_from_sensor,
            body: best.body,
        }
    }

    fn make_sensors(&mut self, path: &Path, options: &OpenOptions, motion: Option<&Motion>) -> Result<()> {
        if motion.is_none() && self.lidars.len() > 1 && options.sensors.is_empty() {
            let others: Vec<_> = self.lidars.drain(1..).map(|lidar| lidar.topic).collect();
            let main = self.lidars.first().map_or("", |lidar| lidar.topic.as_str());
            self.notes.push(format!(
                "only {main} is read, as there are no poses; --sensor chooses among it and {}",
                others.join(", ")
            ));
        }
        let is_of = |lidar: &Lidar, name: &str| lidar.topic.trim_start_matches('/') == name.trim_start_matches('/');
        for (number, lidar) in self.lidars.iter().enumerate() {
            let named = options
                .sensors
                .first()
                .filter(|name| !is_of(lidar, name) && self.lidars.len() == 1);
            self.sensors.push(Sensor {
                model: named
                    .and_then(|name| tsdfuse::sensor::model(name))
                    .or_else(|| lidar.beams()),
                body_from_sensor: motion
                    .and_then(|m| m.body_from_sensor.get(number).copied())
                    .unwrap_or_default(),
                ..Sensor::new(&lidar.topic)
            });
            for fact in &lidar.facts {
                self.recorded.conclusions.push((lidar.topic.clone(), fact.clone()));
            }
            if !lidar.frame.is_empty() {
                self.recorded
                    .conclusions
                    .push((lidar.topic.clone(), format!("frame: {}", lidar.frame)));
            }
        }
        if self.lidars.is_empty() {
            let lasers = self
                .bag
                .channels()
                .iter()
                .any(|channel| channel.short_kind() == "LaserScan");
            let kinds: Vec<_> = self
                .bag
                .channels()
                .iter()
                .map(|c| format!("{} ({})", c.topic, c.kind))
                .collect();
            let why = match (lasers, kinds.is_empty()) {
                (_, true) => "it holds no messages".to_owned(),
                (true, _) => "a LaserScan is one line in a plane, from which no surface follows".to_owned(),
                _ => format!("its topics are {}", kinds.join(", ")),
            };
            self.notes.push(format!("{} holds no scans: {why}", path.display()));
        }
        Ok(())
    }

    fn make_scans(&mut self, motion: Option<&Motion>) {
        let mut all = Vec::new();
        let mut outside = 0;
        for (number, lidar) in self.lidars.iter().enumerate() {
            let sitting = motion
                .and_then(|m| m.body_from_sensor.get(number).copied())
                .unwrap_or_default();
            for sweep in 0..lidar.sweeps() {
                let time_ns = lidar.time_ns(sweep);
                let pose = motion.map(|m| poses::at(&m.trajectory, time_ns).map(|pose| pose * sitting));
                match pose {
                    Some(Err(_)) => outside += 1,
                    pose => {
                        let scan = ScanRef {
                            name: format!("{} {sweep:06}", lidar.topic),
                            sensor: number,
                            time_ns: Some(time_ns),
                            pose: pose.and_then(Result::ok),
                        };
                        all.push((time_ns, (number, sweep), scan));
                    }
                }
            }
            let back = lidar.times_ns.windows(2).filter(|pair| pair[0] > pair[1]).count();
            if back > 0 {
                self.notes.push(format!(
                    "{}: time goes back {back} times; scans are put in order of time",
                    lidar.topic
                ));
            }
        }
        if outside > 0 {
            let total = all.len() + outside;
            self.notes.push(format!(
                "{outside} of {total} scans are left out: there are no poses at their times"
            ));
        }
        all.sort_by_key(|(time_ns, place, _)| (*time_ns, *place));
        (self.places, self.scans) = all.into_iter().map(|(_, place, scan)| (place, scan)).unzip();
    }

    fn find_imu(&mut self, motion: Option<&Motion>) {
        let of = |wanted: Use| {
            let channels = self.bag.channels().iter().enumerate();
            let found = channels
                .filter(move |(_, channel)| use_of(channel) == wanted)
                .map(|(number, _)| number);
            found
                .filter(|number| self.survey.stamps.contains_key(number))
                .collect::<Vec<_>>()
        };
        let body = motion.map(|m| m.body.as_str());
        let body = body
            .or(self.lidars.first().map(|lidar| lidar.frame.as_str()))
            .unwrap_or_default();
        let frame_of = |channel: &usize| {
            let stamps = self.survey.stamps.get(channel);
            stamps.map_or("", |stamps| stamps.frame.as_str())
        };
        let antenna = |channel: usize| {
            let body_from_antenna = self.survey.frames.between(body, frame_of(&channel));
            let at = body_from_antenna.map_or(DVec3::ZERO, |pose| pose.translation);
            (channel, at.to_array())
        };
        self.gnss = of(Use::Gnss).into_iter().map(antenna).collect();
        let mut units = of(Use::Imu);
        units.sort_by_key(|&number| std::cmp::Reverse(self.bag.entries(number).len()));
        let Some((&channel, others)) = units.split_first() else {
            self.find_imu_packets(motion);
            return;
        };
        let frame = frame_of(&channel);
        let is_same = frame.trim_start_matches('/') == body.trim_start_matches('/');
        let body_from_imu = if is_same {
            Some(Pose::IDENTITY)
        } else {
            self.survey.frames.between(body, frame)
        };
        let topic = |number: usize| {
            self.bag
                .channels()
                .get(number)
                .map_or(String::new(), |c| c.topic.clone())
        };
        let mut line = topic(channel);
        line += &match body_from_imu {
            Some(_) if is_same => format!(", in the frame {frame}"),
            Some(_) => format!(", turned from {frame} into {body}"),
            None => format!(", in its own frame {frame}: how it is turned against {body} is not told"),
        };
        if !others.is_empty() {
            let others: Vec<_> = others.iter().map(|&number| topic(number)).collect();
            line += &format!("; others: {}", others.join(", "));
        }
        self.imu = Some(Inertial {
            channel,
            lidar: None,
            body_from_imu,
        });
        self.conclude("IMU", line);
    }

    /// The inertial measurement unit of a LiDAR, whose packets its driver publishes beside those of the LiDAR.
    fn find_imu_packets(&mut self, motion: Option<&Motion>) {
        let parent = |topic: &str| topic.rsplit_once('/').map(|(parent, _)| parent.to_owned());
        let beside = |topic: &str| {
            let is_its = |lidar: &Lidar| lidar.packets().is_some() && parent(&lidar.topic) == parent(topic);
            self.lidars.iter().position(is_its)
        };
        let mut channels = self.bag.channels().iter().enumerate();
        let found = channels.find_map(|(channel, c)| {
            let is_it = is_imu_packets(c) && self.survey.schemas.contains_key(&channel);
            Some((channel, c.topic.clone(), beside(&c.topic).filter(|_| is_it)?))
        });
        let Some((channel, topic, lidar)) = found else { return };
        let sitting = motion.and_then(|m| m.body_from_sensor.get(lidar).copied());
        self.imu = Some(Inertial {
            channel,
            lidar: Some(lidar),
            body_from_imu: sitting.or((lidar == 0).then_some(Pose::IDENTITY)),
        });
        self.conclude("IMU", format!("{topic}, packets of the LiDAR's own unit"));
    }

    fn find_images(&mut self, motion: Option<&Motion>) {
        let main = self.lidars.first().map(|lidar| lidar.frame.clone()).unwrap_or_default();
        let body_from_main = motion
            .and_then(|m| m.body_from_sensor.first().copied())
            .unwrap_or_default();
        let mut cameras: Vec<(usize, String, Pinhole, Option<[f64; 5]>)> = Vec::new();
        let mut unknown = Vec::new();
        let channels = self.bag.channels();
        for (number, channel) in channels
            .iter()
            .enumerate()
            .filter(|(_, c)| use_of(c) == Use::CameraInfo)
        {
            let told = self.survey.schemas.get(&number).zip(self.bag.entries(number).first());
            let Some((schema, entry)) = told else { continue };
            match with_message(&self.bag, number, schema, entry, messages::camera) {
                Ok((camera, distortion)) => cameras.push((number, channel.topic.clone(), camera, distortion)),
                Err(error) => unknown.push(error.to_string()),
            }
        }
        let mut missing = Vec::new();
        for (number, channel) in channels.iter().enumerate().filter(|(_, c)| use_of(c) == Use::Image) {
            let Some(stamps) = self.survey.stamps.get(&number) else {
                continue;
            };
            let frame_of = |number: usize| {
                self.survey
                    .stamps
                    .get(&number)
                    .map_or("", |stamps| stamps.frame.as_str())
            };
            // By the name of the topic, which is usual; else by the frame.
            let beside = |info: &str| {
                let (parent, _) = info.rsplit_once('/').unwrap_or_default();
                !parent.is_empty() && channel.topic.starts_with(&format!("{parent}/"))
            };
            let camera = cameras.iter().find(|(_, info, ..)| beside(info));
            let camera = camera.or_else(|| cameras.iter().find(|(info, ..)| frame_of(*info) == stamps.frame));
            let Some((_, _, camera, distortion)) = camera else {
                missing.push(channel.topic.clone());
                continue;
            };
            let body_from_camera = self
                .survey
                .frames
                .between(&main, &stamps.frame)
                .map(|main_from_camera| body_from_main * main_from_camera);
            for (index, (entry, &time_ns)) in self.bag.entries(number).iter().zip(&stamps.times_ns).enumerate() {
                let at = motion.and_then(|m| poses::at(&m.trajectory, time_ns).ok());
                self.images.push(ImageRef {
                    name: format!("{} {index:06}", channel.topic),
                    time_ns: Some(time_ns),
                    camera: *camera,
                    distortion: *distortion,
                    pose: at.zip(body_from_camera).map(|(body, camera)| body * camera),
                    path: None,
                });
                self.image_places.push((number, *entry));
            }
        }
        self.notes.extend(unknown);
        for topic in missing {
            self.notes.push(format!(
                "{topic}: its images are left out, as no CameraInfo tells of the camera"
            ));
        }
    }

    fn list_topics(&mut self) {
        for (number, channel) in self.bag.channels().iter().enumerate() {
            let entries = self.bag.entries(number);
            let stamps: Option<&Stamps> = self.survey.stamps.get(&number);
            let times: Vec<i64> = entries.iter().map(|entry| entry.time_ns).collect();
            let gap = times
                .windows(2)
                .map(|pair| secs_between(pair[0], pair[1]))
                .reduce(f64::max);
            let track = self.survey.tracks.iter().find(|track| track.topic == channel.topic);
            let first = times.first().copied();
            self.recorded.topics.push(Topic {
                name: channel.topic.clone(),
                kind: channel.kind.clone(),
                messages: entries.len(),
                rate_hz: motion::rate_hz(&times),
                longest_gap_secs: gap,
                span_secs: first
                    .zip(times.last().copied())
                    .map(|(first, last)| secs_between(first, last)),
                delay_secs: stamps
                    .and_then(|stamps| stamps.delay_secs)
                    .or(track.and_then(|track| track.delay_secs)),
                is_read: self.lidars.iter().any(|lidar| lidar.channel == number),
            });
        }
    }
}

impl Source for Recording {
    fn format(&self) -> &str {
        self.bag.format()
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let place = self.places.get(index).copied();
        let told = place.and_then(|(lidar, sweep)| Some((self.lidars.get(lidar)?, self.sensors.get(lidar)?, sweep)));
        let (Some((lidar, sensor, sweep)), Some(scan)) = (told, self.scans.get(index)) else {
            return Err(Error::dataset(self.bag.format(), format!("no scan {index}")));
        };
        let read = lidar.read(&self.bag, sweep)?;
        let time_ns = lidar.time_ns(sweep);
        let motion = match (&self.trajectory, &read.secs) {
            (Some(trajectory), Some(secs)) => {
                let within = motion_within(trajectory, time_ns, secs, &sensor.body_from_sensor);
                let (begin, end) = trajectory.span_ns();
                // During the first and the last sweep, the sensor may move where poses end.
                if within.is_empty() && !(begin < time_ns && time_ns < end) {
                    placed::motion(&self.scans, index, secs, None, &sensor.body_from_sensor)
                } else {
                    within
                }
            }
            _ => Vec::new(),
        };
        Ok(Scan {
            name: scan.name.clone(),
            time_ns: scan.time_ns,
            points: read.points,
            rings: read.rings,
            times: read.secs,
            intensities: read.intensities,
            pose: scan.pose,
            motion,
            ..Scan::default()
        })
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.trajectory.as_ref()
    }

    fn imu(&self) -> Result<Vec<ImuSample>> {
        let Some(Inertial {
            channel,
            lidar,
            body_from_imu,
        }) = &self.imu
        else {
            return Ok(Vec::new());
        };
        let Some(schema) = self.survey.schemas.get(channel) else {
            return Ok(Vec::new());
        };
        let packets = lidar.and_then(|lidar| self.lidars.get(lidar)?.packets());
        let mut samples = match packets {
            Some(packets) => packets.imu(&self.bag, *channel, schema)?,
            None => {
                let entries = self.bag.entries(*channel).iter();
                let read = |entry| with_message(&self.bag, *channel, schema, entry, messages::imu);
                entries.map(read).collect::<Result<Vec<_>>>()?
            }
        };
        samples.sort_by_key(|sample| sample.time_ns);
        let mut lengths: Vec<f64> = samples.iter().map(|sample| sample.acceleration.length()).collect();
        // Accelerometers that show about 1 at rest show g.
        let is_in_g = (0.5..2.0).contains(&super::point_times::median(&mut lengths));
        for sample in &mut samples {
            if is_in_g {
                sample.acceleration *= STANDARD_GRAVITY;
            }
            if let Some(pose) = body_from_imu {
                sample.angular_velocity = pose.rotation * sample.angular_velocity;
                sample.acceleration = pose.rotation * sample.acceleration;
                sample.orientation = sample
                    .orientation
                    .map(|world_from_imu| world_from_imu * pose.rotation.inverse());
            }
        }
        Ok(samples)
    }

    fn gnss(&self) -> Result<Vec<GnssFix>> {
        let mut fixes = Vec::new();
        for &(channel, antenna_m) in &self.gnss {
            let told = self.survey.schemas.get(&channel).zip(self.survey.stamps.get(&channel));
            let Some((schema, stamps)) = told else { continue };
            for (entry, &time_ns) in self.bag.entries(channel).iter().zip(&stamps.times_ns) {
                if let Some(fix) = with_message(&self.bag, channel, schema, entry, messages::fix)? {
                    fixes.push(GnssFix {
                        time_ns,
                        antenna_m,
                        ..fix
                    });
                }
            }
            // Two receivers must not be mixed.
            if !fixes.is_empty() {
                break;
            }
        }
        fixes.sort_by_key(|fix| fix.time_ns);
        Ok(fixes)
    }

    fn images(&self) -> &[ImageRef] {
        &self.images
    }

    fn read_image(&self, index: usize) -> Result<Vec<u8>> {
        let place = self.image_places.get(index);
        let told = place.and_then(|(channel, entry)| Some((*channel, self.survey.schemas.get(channel)?, entry)));
        let Some((channel, schema, entry)) = told else {
            let reason = format!("no image {index}: there are {} images", self.images.len());
            return Err(Error::dataset(self.bag.format(), reason));
        };
        with_message(&self.bag, channel, schema, entry, images::encoded)
    }

    fn recorded(&self) -> Option<&Recorded> {
        Some(&self.recorded)
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// How a sensor moves while points are measured, as far as its trajectory has no gap then.
pub(crate) fn motion_within(
    trajectory: &Trajectory,
    time_ns: i64,
    secs: &[f32],
    body_from_sensor: &Pose,
) -> Vec<PoseAt> {
    let finite = secs.iter().copied().filter(|t| t.is_finite()).map(f64::from);
    let (first, last) = finite.fold((0.0f64, 0.0f64), |(first, last), t| (first.min(t), last.max(t)));
    let (begin, end) = trajectory.span_ns();
    let known = |secs: f64| ns_after(time_ns, secs).clamp(begin, end);
    if last <= first || !poses::covers(trajectory, known(first), known(last)) {
        return Vec::new();
    }
    let within = trajectory.motion_within(time_ns, first, last, body_from_sensor);
    within.map_or(Vec::new(), |(_, motion)| motion)
}
