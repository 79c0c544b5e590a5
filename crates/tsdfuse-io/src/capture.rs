//! Captures of a LiDAR's packets from the network: PCAP and pcapng.
//!
//! A capture is gone through once when it is opened: which sensors send packets, and where their sweeps begin and end. Sweeps are
//! decoded when they are read, in any order; no more than one is in memory then. Sensors are identified by their packets
//! (`tsdfuse_packets`) and kept apart by address and port. Calibrations are looked for beside the capture.
//!
//! A sweep that covers less than half of what sweeps of its sensor do is left out if it is the first or the last one: the
//! capture began or ended within it.

mod datagrams;
mod parts;
mod records;
pub(crate) mod writer;

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use tsdfuse::trajectory::secs_between;
use tsdfuse::{Pose, Scan, Trajectory};
use tsdfuse_packets::{Calibration, Decoder, Maker, Position, Sensor as Model};

use crate::calibrations::Calibrations;
use crate::error::{Error, Result};
use crate::mounted::Mounted;
use crate::placed;
use crate::poses::{self, Poses};
use crate::source::{GnssFix, ImuSample, OpenOptions, ScanRef, Sensor, Source};
pub(crate) use datagrams::{Datagram, Datagrams, Flow};
pub(crate) use records::{Layout, Records};

/// More sensors than any capture has.
const MAX_SENSORS: usize = 64;
/// Of a capture that is only to be described, this much is read.
const GLANCE_BYTES: u64 = 64 << 20;
/// Clocks that differ by less are taken to be set alike, seconds.
const SAME_CLOCK_SECS: f64 = 1.0;

/// Whether it is a capture, or a folder with the files of one.
pub(crate) fn recognises(path: &Path) -> bool {
    !parts::paths(path).is_empty()
}

/// A sensor that sends packets.
struct Sender {
    flow: Flow,
    model: Model,
    calibration: Calibration,
    decoder: Decoder,
    sweeps: Vec<Spot>,
    /// The sweep that is not at its end yet.
    open: Option<Spot>,
    /// The last two datagrams' offsets: a sweep is read from there on, so that no fragment of its first packet is missed.
    before: [u64; 2],
    /// Packets that are none of this sensor, and what was wrong with the first one.
    bad: u64,
    bad_reason: String,
    imu_packets: u64,
    /// Of a GNSS receiver, on the sensor's clock, and how often it told no place.
    fixes: Vec<GnssFix>,
    void: u64,
    notes: Vec<String>,
}

/// Where a sweep is in the file.
#[derive(Clone, Copy, Debug)]
struct Spot {
    /// From where on to read.
    seek: u64,
    /// Offsets of the first and the last datagram, and which of their columns belong to the sweep.
    first: (u64, usize),
    last: (u64, usize),
    /// Of the sweep, and of its first packet, on the sensor's clock.
    time_ns: i64,
    packet_ns: i64,
    received_ns: i64,
    /// How much of a turn it covers.
    turn: f32,
}

/// An opened capture.
pub(crate) struct Capture {
    path: PathBuf,
    format: &'static str,
    layout: Layout,
    /// What comes from there on is not looked at.
    end: u64,
    senders: Vec<Sender>,
    sensors: Vec<Sensor>,
    scans: Vec<ScanRef>,
    /// Sender and number there of each scan.
    spots: Vec<(usize, Spot)>,
    /// Added to the clock of each sender.
    shifts_ns: Vec<i64>,
    trajectory: Option<Trajectory>,
    notes: Vec<String>,
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Capture> {
    let survey = Survey::of(path, options)?;
    Capture::new(path, survey, options)
}

/// What going through the file finds.
struct Survey {
    layout: Layout,
    /// Where it stopped.
    end: u64,
    senders: Vec<Sender>,
    notes: Vec<String>,
}

impl Survey {
    fn of(path: &Path, options: &OpenOptions) -> Result<Self> {
        let calibrations = Calibrations::given_or_beside(options.calibration.as_deref(), path)?;
        let told = match options.sensors.as_slice() {
            [name] => Model::named(name),
            _ => None,
        };
        let mut datagrams = Datagrams::new(Records::open(path)?);
        let mut senders: Vec<Sender> = Vec::new();
        let mut refused: Vec<(Flow, String)> = Vec::new();
        let mut others = 0_u64;
        let mut end = u64::MAX;
        while let Some(datagram) = datagrams.next()? {
            if options.glance && datagram.offset > GLANCE_BYTES {
                end = datagram.offset;
                break;
            }
            if let Some(sender) = senders.iter_mut().find(|sender| sender.flow == datagram.flow) {
                sender.take(&datagram);
                continue;
            }
            let mut here = senders
                .iter_mut()
                .filter(|sender| sender.flow.source == datagram.flow.source);
            if here.any(|sender| sender.take_beside(&datagram)) {
                continue;
            }
            let is_refused = refused.iter().any(|(flow, _)| *flow == datagram.flow);
            let model = if is_refused {
                None
            } else {
                Model::recognise(datagram.payload)
            };
            // The model that was named, where packets do not tell another one of its maker.
            let model = match (model, told) {
                (Some(found), Some(told)) if found.maker() == told.maker() && told.maker() != Maker::Ouster => {
                    Some(told)
                }
                (None, Some(told)) if !is_refused && datagram.payload.len() > 500 => Some(told),
                (found, _) => found,
            };
            let Some(model) = model else {
                others += 1;
                continue;
            };
            if senders.len() + refused.len() >= MAX_SENSORS {
                return Err(Error::format(
                    path,
                    format!("holds packets of more than {MAX_SENSORS} sensors"),
                ));
            }
            match Sender::new(&datagram, model, &calibrations) {
                Ok(mut sender) => {
                    sender.take(&datagram);
                    // Packets of a position alone are no sensor's that was named.
                    if sender.decoder.counts().packets + sender.bad > 0 {
                        senders.push(sender);
                    }
                }
                Err(reason) => refused.push((datagram.flow, reason)),
            }
        }
        let (unreadable, damage) = (datagrams.unreadable, datagrams.records().damage().map(str::to_owned));
        senders.iter_mut().for_each(Sender::end);
        senders.retain(|sender| !sender.sweeps.is_empty());
        let mut notes: Vec<String> = Vec::new();
        notes.extend(damage.map(|damage| format!("the capture {damage}: what comes after is left out")));
        if senders.is_empty() {
            let found = notes
                .into_iter()
                .chain(refused.into_iter().map(|(_, reason)| reason))
                .next();
            let reason = found.unwrap_or_else(|| "holds no packets of a LiDAR that is known".to_owned());
            return Err(Error::format(path, reason));
        }
        notes.extend(
            refused
                .into_iter()
                .map(|(flow, reason)| format!("packets from {} are left out: {reason}", name_of(&flow))),
        );
        if end < u64::MAX {
            let mib = GLANCE_BYTES >> 20;
            notes.push(format!(
                "this is an overview: only the first {mib} MiB of the capture were read"
            ));
        }
        if unreadable > 0 {
            notes.push(format!(
                "{unreadable} frames of the network are cut short, damaged or of an unknown link: left out"
            ));
        }
        if others > 0 {
            notes.push(format!("{others} other datagrams are left out"));
        }
        Ok(Self {
            layout: datagrams.records().layout().clone(),
            end,
            senders,
            notes,
        })
    }
}

/// Keeps those of a list that are marked.
fn keep<T>(all: &mut Vec<T>, is_kept: &[bool]) {
    let mut is_kept = is_kept.iter();
    all.retain(|_| is_kept.next().copied().unwrap_or(false));
}

fn name_of(flow: &Flow) -> String {
    match flow.source {
        IpAddr::V4(ip) => format!("{ip}:{}", flow.port),
        IpAddr::V6(ip) => format!("[{ip}]:{}", flow.port),
    }
}

impl Sender {
    fn new(datagram: &Datagram, model: Model, calibrations: &Calibrations) -> std::result::Result<Self, String> {
        let mut notes = Vec::new();
        let calibration = match calibrations.of(model, datagram.payload) {
            Some((path, calibration)) => {
                let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
                notes.push(format!("the calibration of the {} is {name}", model.name()));
                calibration.clone()
            }
            None => Calibration::Nominal,
        };
        let unreadable = &calibrations.unreadable;
        let decoder = Decoder::new(model, calibration.clone()).map_err(|reason| match unreadable.first() {
            Some(why) => format!("{reason}; {why}"),
            None => format!("{reason}, and none that fits lies beside the capture"),
        })?;
        Ok(Self {
            flow: datagram.flow,
            model,
            calibration,
            decoder,
            sweeps: Vec::new(),
            open: None,
            before: [datagram.offset; 2],
            bad: 0,
            bad_reason: String::new(),
            imu_packets: 0,
            fixes: Vec::new(),
            void: 0,
            notes,
        })
    }

    /// Takes what the sensor sends beside packets of returns; whether it is that.
    fn take_beside(&mut self, datagram: &Datagram) -> bool {
        let is_imu = !self.decoder.imu(datagram.received_ns, datagram.payload).is_empty();
        self.imu_packets += u64::from(is_imu);
        match self.decoder.position(datagram.received_ns, datagram.payload) {
            Some(Position::Fix {
                time_ns,
                latitude_deg,
                longitude_deg,
            }) => self.fixes.push(GnssFix {
                time_ns,
                latitude_deg,
                longitude_deg,
                ..GnssFix::default()
            }),
            Some(Position::Repeated) => {}
            Some(Position::Void) => self.void += 1,
            None => return is_imu,
        }
        true
    }

    /// Follows a packet.
    fn take(&mut self, datagram: &Datagram) {
        let seek = self.before[0];
        self.before = [self.before[1], datagram.offset];
        let place = match self.decoder.place(datagram.received_ns, datagram.payload) {
            Ok(Some(place)) => place,
            Ok(None) => {
                self.take_beside(datagram);
                return;
            }
            Err(reason) => {
                if self.bad == 0 {
                    self.bad_reason = reason.to_string();
                }
                self.bad += 1;
                return;
            }
        };
        let mut from = 0;
        if let Some((column, time_ns)) = place.begins {
            if let Some(mut done) = self.open.take() {
                if column > 0 {
                    done.last = (datagram.offset, column);
                    done.turn += column as f32 * place.turn_per_column;
                }
                self.sweeps.push(done);
            }
            from = column;
            self.open = Some(Spot {
                seek,
                first: (datagram.offset, column),
                last: (datagram.offset, place.columns),
                time_ns,
                packet_ns: place.time_ns,
                received_ns: datagram.received_ns,
                turn: 0.0,
            });
        }
        let open = self.open.get_or_insert(Spot {
            seek,
            first: (datagram.offset, 0),
            last: (datagram.offset, place.columns),
            time_ns: place.time_ns,
            packet_ns: place.time_ns,
            received_ns: datagram.received_ns,
            turn: 0.0,
        });
        open.last = (datagram.offset, place.columns);
        open.turn += (place.columns - from) as f32 * place.turn_per_column;
    }

    /// At the end of the file: what was begun is a sweep, and parts at either end are left out.
    fn end(&mut self) {
        self.sweeps.extend(self.open.take());
        let mut turns: Vec<f32> = self.sweeps.iter().map(|sweep| sweep.turn).collect();
        turns.sort_by(f32::total_cmp);
        let half = turns.get(turns.len() / 2).copied().unwrap_or(0.0) / 2.0;
        let is_part = |sweep: Option<&Spot>| sweep.is_some_and(|sweep| sweep.turn < half);
        let mut left_out = 0;
        if self.sweeps.len() > 1 && is_part(self.sweeps.last()) {
            self.sweeps.pop();
            left_out += 1;
        }
        if self.sweeps.len() > 1 && is_part(self.sweeps.first()) {
            self.sweeps.remove(0);
            left_out += 1;
        }
        if left_out > 0 {
            let which = if left_out == 1 {
                "a sweep at the capture's begin or end is"
            } else {
                "the capture's first and last sweep are"
            };
            self.notes.push(format!("{which} mostly missing: left out"));
        }
    }

    /// How late packets were received, by the sensor's clock, seconds.
    fn clock_secs(&self) -> f64 {
        self.sweeps
            .first()
            .map_or(0.0, |sweep| secs_between(sweep.packet_ns, sweep.received_ns))
    }

    /// What is to be told of it.
    fn notes(&self, name: &str) -> Vec<String> {
        let counts = self.decoder.counts();
        let mut notes: Vec<String> = self.notes.clone();
        notes.extend(self.decoder.notes());
        let late = if counts.late > 0 {
            format!(", {} late", counts.late)
        } else {
            String::new()
        };
        let packets = format!(
            "{name}: {} packets from {}, {} lost{late}",
            counts.packets,
            name_of(&self.flow),
            counts.lost
        );
        notes.push(packets);
        if self.bad > 0 {
            notes.push(format!(
                "{name}: {} packets are left out; the first one: {}",
                self.bad, self.bad_reason
            ));
        }
        if self.void > 0 {
            notes.push(format!(
                "{name}: {} sentences of its GNSS receiver tell no place or are damaged: left out",
                self.void
            ));
        }
        notes
    }

    /// The sensor's name where it is the only one of its model.
    fn plain_name(&self) -> String {
        match &self.calibration {
            Calibration::Ouster(metadata) => metadata.name(),
            _ => self.model.name().to_owned(),
        }
    }
}

impl Capture {
    fn new(path: &Path, survey: Survey, options: &OpenOptions) -> Result<Self> {
        let Survey {
            layout,
            end,
            mut senders,
            mut notes,
        } = survey;
        let plain: Vec<String> = senders.iter().map(Sender::plain_name).collect();
        let name = |i: usize| match plain.iter().filter(|name| **name == plain[i]).count() {
            1 => plain[i].clone(),
            _ => format!("{}@{}", plain[i], name_of(&senders[i].flow)),
        };
        let names: Vec<String> = (0..senders.len()).map(name).collect();
        // Sensors by their names; one name of a single sensor's model was told to the survey.
        let is_asked = |i: usize| {
            options.sensors.is_empty()
                || options
                    .sensors
                    .iter()
                    .any(|asked| *asked == names[i] || *asked == plain[i])
                || (senders.len() == 1 && options.sensors.len() == 1)
        };
        let asked: Vec<bool> = (0..senders.len()).map(is_asked).collect();
        if !asked.contains(&true) {
            let reason = format!(
                "has no sensor {}; there are: {}",
                options.sensors.join(", "),
                names.join(", ")
            );
            return Err(Error::dataset(path, reason));
        }
        let mut names = names;
        keep(&mut senders, &asked);
        keep(&mut names, &asked);
        let told: Vec<Option<Pose>> = senders
            .iter()
            .map(|sender| sender.calibration.body_from_sensor())
            .collect();
        let amounts: Vec<usize> = senders.iter().map(|sender| sender.sweeps.len()).collect();
        let mounted = Mounted::choose(path, &names, &amounts, &told, options.poses.is_some(), options)?;
        keep(&mut senders, &mounted.is_kept);
        keep(&mut names, &mounted.is_kept);
        notes.extend(mounted.notes);

        let sensors = senders.iter().zip(&names).zip(mounted.body_from_sensor);
        let sensors = sensors.map(|((sender, name), body_from_sensor)| Sensor {
            model: sender.decoder.model(),
            body_from_sensor,
            ..Sensor::new(name)
        });
        let sensors: Vec<Sensor> = sensors.collect();
        for (sender, name) in senders.iter().zip(&names) {
            notes.extend(sender.notes(name));
        }
        let mut this = Self {
            path: path.to_owned(),
            format: match layout {
                Layout::Pcap { .. } => "PCAP capture",
                Layout::PcapNg(_) => "pcapng capture",
            },
            layout,
            end,
            shifts_ns: vec![0; senders.len()],
            senders,
            sensors,
            scans: Vec::new(),
            spots: Vec::new(),
            trajectory: None,
            notes,
        };
        this.set_clocks();
        this.list_scans();
        this.place_scans(options)?;
        Ok(this)
    }

    /// One sensor's times are its own; of several, those whose clocks are not set are moved to the receiver's.
    fn set_clocks(&mut self) {
        let late: Vec<f64> = self.senders.iter().map(Sender::clock_secs).collect();
        let is_off = |secs: f64| secs.abs() > SAME_CLOCK_SECS;
        match late.as_slice() {
            [secs] if is_off(*secs) => self.notes.push(format!(
                "times are those of the sensor's clock, which is {secs:.3} s behind the capture's"
            )),
            [_] => {}
            _ => {
                for (i, secs) in late.iter().copied().enumerate().filter(|(_, secs)| is_off(*secs)) {
                    self.shift(i);
                    let name = &self.sensors[i].name;
                    self.notes.push(format!(
                        "the clock of {name} is {secs:.3} s behind the capture's: its times are moved by that"
                    ));
                }
            }
        }
    }

    /// Moves a sensor's times to the receiver's clock.
    fn shift(&mut self, sender: usize) {
        let first = self.senders[sender].sweeps.first();
        self.shifts_ns[sender] = first.map_or(0, |sweep| sweep.received_ns.saturating_sub(sweep.packet_ns));
    }

    fn list_scans(&mut self) {
        let mut all: Vec<(i64, usize, usize, Spot)> = Vec::new();
        for (i, sender) in self.senders.iter().enumerate() {
            let time_ns = |spot: &Spot| spot.time_ns.saturating_add(self.shifts_ns[i]);
            all.extend(
                sender
                    .sweeps
                    .iter()
                    .enumerate()
                    .map(|(number, spot)| (time_ns(spot), i, number, *spot)),
            );
        }
        // A sensor that was switched on again counts from another begin: then the file's order is kept.
        if self.senders.len() > 1 || !all.is_sorted_by_key(|(_, _, number, _)| *number) {
            all.sort_by_key(|(time_ns, sender, number, _)| (*time_ns, *sender, *number));
        }
        let several = self.senders.len() > 1;
        let name = |sender: usize, number: usize| {
            if several {
                format!("{} sweep {number}", self.sensors[sender].name)
            } else {
                format!("sweep {number}")
            }
        };
        self.scans = all
            .iter()
            .map(|&(time_ns, sensor, number, _)| ScanRef {
                name: name(sensor, number),
                sensor,
                time_ns: Some(time_ns),
                pose: None,
            })
            .collect();
        self.spots = all.into_iter().map(|(_, sender, _, spot)| (sender, spot)).collect();
    }

    fn place_scans(&mut self, options: &OpenOptions) -> Result<()> {
        let Some(path) = &options.poses else { return Ok(()) };
        let poses = poses::read(path)?;
        // Poses may be on the receiver's clock, though the sensor's is another one.
        if let (Poses::Timed(timed), [_]) = (&poses, self.senders.as_slice()) {
            let (from, to) = timed.span_ns();
            let is_within = |time_ns: i64| (from..=to).contains(&time_ns);
            let is_of_sensor = self.scans.iter().filter_map(|scan| scan.time_ns).any(is_within);
            if !is_of_sensor && self.spots.iter().any(|(_, spot)| is_within(spot.received_ns)) {
                self.shift(0);
                self.list_scans();
                self.notes
                    .push("the poses are on the capture's clock: the scans' times are moved to it".to_owned());
            }
        }
        let (scans, spots) = (&mut self.scans, &mut self.spots);
        let (trajectory, note) = placed::by_file(&self.path, path, poses, &self.sensors, scans, spots)?;
        self.trajectory = trajectory;
        self.notes.extend(note);
        Ok(())
    }

    /// Decodes a sweep.
    fn sweep(&self, index: usize) -> Result<Scan> {
        let (i, spot) = self.spots[index];
        let (sender, scan) = (&self.senders[i], &self.scans[index]);
        let wrong = |reason: String| Error::format(&self.path, format!("{}: {reason}", scan.name));
        let mut decoder = Decoder::new(sender.model, sender.calibration.clone()).map_err(|e| wrong(e.to_string()))?;
        decoder.resume(spot.packet_ns, spot.received_ns);
        let mut datagrams = Datagrams::new(Records::resume(&self.path, &self.layout, spot.seek)?);
        let mut has_begun = false;
        while let Some(datagram) = datagrams.next()? {
            if datagram.flow != sender.flow {
                if datagram.offset > spot.last.0 {
                    break;
                }
                continue;
            }
            has_begun |= datagram.offset == spot.first.0;
            if !has_begun {
                continue;
            }
            let from = if datagram.offset == spot.first.0 {
                spot.first.1
            } else {
                0
            };
            let to = if datagram.offset == spot.last.0 {
                spot.last.1
            } else {
                usize::MAX
            };
            // What is no packet was counted when the capture was opened.
            let _ = decoder.decode(datagram.received_ns, datagram.payload, from..to);
            if datagram.offset >= spot.last.0 {
                break;
            }
        }
        let sweep = decoder
            .take()
            .ok_or_else(|| wrong("has no packets any more: the file has changed".to_owned()))?;
        Ok(sweep.scan)
    }
}

impl Source for Capture {
    fn format(&self) -> &str {
        self.format
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let mut scan = self.sweep(index)?;
        let told = &self.scans[index];
        let times = scan.times.as_deref().unwrap_or_default();
        let sensor = &self.sensors[told.sensor];
        scan.motion = placed::motion(
            &self.scans,
            index,
            times,
            self.trajectory.as_ref(),
            &sensor.body_from_sensor,
        );
        (scan.name, scan.time_ns, scan.pose) = (told.name.clone(), told.time_ns, told.pose);
        Ok(scan)
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.trajectory.as_ref()
    }

    fn imu(&self) -> Result<Vec<ImuSample>> {
        let mut samples = Vec::new();
        let sender = self
            .senders
            .iter()
            .enumerate()
            .find(|(_, sender)| sender.imu_packets > 0);
        let Some((i, sender)) = sender else { return Ok(samples) };
        let mut datagrams = Datagrams::new(Records::resume(&self.path, &self.layout, self.layout.begin())?);
        while let Some(datagram) = datagrams.next()? {
            if datagram.offset >= self.end {
                break;
            }
            if datagram.flow.source == sender.flow.source {
                samples.extend(sender.decoder.imu(datagram.received_ns, datagram.payload));
            }
        }
        let sensor = &self.sensors[i];
        for sample in &mut samples {
            sample.time_ns = sample.time_ns.saturating_add(self.shifts_ns[i]);
            sample.angular_velocity = sensor.body_from_sensor.rotation * sample.angular_velocity;
            sample.acceleration = sensor.body_from_sensor.rotation * sample.acceleration;
        }
        samples.sort_by_key(|sample| sample.time_ns);
        Ok(samples)
    }

    fn gnss(&self) -> Result<Vec<GnssFix>> {
        let senders = self.senders.iter().zip(&self.shifts_ns);
        // Two receivers must not be mixed.
        let with_fixes = senders.filter(|(sender, _)| !sender.fixes.is_empty()).take(1);
        let fixes = with_fixes.flat_map(|(sender, shift_ns)| {
            sender.fixes.iter().map(|fix| GnssFix {
                time_ns: fix.time_ns.saturating_add(*shift_ns),
                ..*fix
            })
        });
        let mut fixes: Vec<_> = fixes.collect();
        fixes.sort_by_key(|fix| fix.time_ns);
        Ok(fixes)
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

#[cfg(test)]
mod tests;
