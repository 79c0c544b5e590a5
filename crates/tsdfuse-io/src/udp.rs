//! LiDARs that send packets now: `udp://:2368`, `udp://192.168.1.5:2368` or a multicast group.
//!
//! A thread receives and decodes; the newest sweep that is complete waits for whoever fuses. If that takes longer than a turn,
//! sweeps in between are left out: what is fused is never old, and memory does not grow. What was lost, by the network or in this
//! way, is counted. The stream ends when nothing has come for [`SILENCE_SECS`], and at once when its reader is dropped. On demand, all packets
//! are kept as a capture, which can be read again and in which no sweep is left out.
//!
//! Packets of one sender are read: of the first one from which packets of a LiDAR come. Its model is recognised, or told
//! (`OpenOptions::sensors`). An Ouster needs its metadata (`OpenOptions::calibration`).
//!
//! What the sensor sends beside packets of returns, samples of its inertial measurement unit and positions, goes to a port of its own: the maker's, or
//! the one that is told, `udp://:2368,8308`. A sweep waits until the samples of all its time are there.

use std::collections::VecDeque;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::Builder;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tsdfuse::glam::DQuat;
use tsdfuse::trajectory::ns_after;
use tsdfuse_packets::{Calibration, Decoder, Maker, Sensor as Model, Sweep};

use crate::calibrations::Calibrations;
use crate::error::{Error, Result};
use crate::source::{ImuSample, Kept, News, OpenOptions, Sensor, Stream, StreamedScan};

mod kept;

use kept::Packets;

/// Seconds without a packet after which a stream is at its end; also how long the first one is waited for.
pub(crate) const SILENCE_SECS: u64 = if cfg!(test) { 1 } else { 10 };
/// How often the receiver looks whether it is still wanted.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// No datagram is longer.
const MAX_DATAGRAM: usize = 65_536;
/// Samples that wait for a reader: of seconds, whatever the sensor. Older ones are forgotten.
const MAX_SAMPLES: usize = if cfg!(test) { 1 << 8 } else { 1 << 14 };
/// Datagrams that are read from the port beside before it is the returns' turn again.
const BESIDE: usize = 64;

/// The address of `udp://HOST:PORT`; `None` for a path.
pub(crate) fn address(path: &Path) -> Option<&str> {
    path.to_str()?.strip_prefix("udp://")
}

/// What receiver and reader share.
#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    newest: Option<Sweep>,
    imu: VecDeque<ImuSample>,
    is_over: bool,
    is_unwanted: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A LiDAR on the network.
pub(crate) struct Udp {
    name: String,
    sensors: Vec<Sensor>,
    notes: Vec<String>,
    news: News,
    shared: Arc<Shared>,
    packets: Arc<Packets>,
    sweeps: usize,
}

impl Udp {
    /// Binds to the address and waits for the first packet of a LiDAR.
    pub(crate) fn open(address: &str, options: &OpenOptions) -> Result<Self> {
        let name = format!("udp://{address}");
        let wrong = |reason: &str| Error::dataset(&name, reason);
        if options.poses.is_some() {
            return Err(wrong(
                "is a sensor that sends now: there are no poses for it, it is tracked by odometry",
            ));
        }
        let (address, port_beside) = match address.split_once(',') {
            Some((address, port)) => (address, Some(port)),
            None => (address, None),
        };
        let socket = bind(&name, address)?;
        let told = match options.sensors.as_slice() {
            [] => None,
            [model] => {
                let unknown = || {
                    let names: Vec<&str> = Model::ALL.iter().map(|model| model.name()).collect();
                    Error::dataset(
                        &name,
                        format!("{model} is no sensor whose packets are known: {}", names.join(", ")),
                    )
                };
                Some(Model::named(model).ok_or_else(unknown)?)
            }
            _ => return Err(wrong("is one sensor: name one model")),
        };
        let calibrations = match &options.calibration {
            Some(path) => Calibrations::given_or_beside(Some(path), path)?,
            None => Calibrations::default(),
        };
        let mut buffer = vec![0; MAX_DATAGRAM];
        let begin = Instant::now();
        let (first, from, model) = loop {
            if begin.elapsed().as_secs() >= SILENCE_SECS {
                return Err(Error::dataset(
                    &name,
                    format!("no packet of a LiDAR came within {SILENCE_SECS} s"),
                ));
            }
            if let Some((length, from)) = receive(&name, &socket, &mut buffer)? {
                let packet = &buffer[..length];
                let named = || told.filter(|_| packet.len() > 500);
                if let Some(model) = Model::recognise(packet)
                    .map(|found| told.unwrap_or(found))
                    .or_else(named)
                {
                    break (packet.to_vec(), from, model);
                }
            }
        };
        let calibration = match calibrations.of(model, &first) {
            Some((_, calibration)) => calibration.clone(),
            None if options.calibration.is_some() => {
                return Err(wrong("the calibration is not for the sensor that sends"));
            }
            None => Calibration::Nominal,
        };
        let decoder = Decoder::new(model, calibration.clone()).map_err(|reason| wrong(&reason.to_string()))?;
        let model_name = match &calibration {
            Calibration::Ouster(metadata) => metadata.name(),
            _ => model.name().to_owned(),
        };
        let sensor = Sensor {
            model: decoder.model(),
            body_from_sensor: options
                .extrinsics
                .or(calibration.body_from_sensor())
                .unwrap_or_default(),
            ..Sensor::new(model_name)
        };
        let mut notes = vec![format!("{} packets come from {from}", sensor.name)];
        notes.extend(decoder.notes());
        let to = socket.local_addr().map_err(Error::io(&name))?;
        let usual = usual_port_beside(model, &calibration).filter(|&port| port != to.port());
        let beside = match (port_beside, usual) {
            (Some(port), _) => Some(bind_beside(&name, address, port)?),
            (None, Some(port)) => bind_beside(&name, address, &port.to_string())
                .map_err(|reason| notes.push(format!("what comes beside the returns is left out: {reason}")))
                .ok(),
            (None, None) => None,
        };
        let (shared, news) = (Arc::new(Shared::default()), News::default());
        let packets = Arc::new(Packets::new(&name));
        let receiver = Receiver {
            name: name.clone(),
            socket,
            to,
            beside,
            sender: from,
            body_from_sensor: sensor.body_from_sensor.rotation,
            decoder,
            shared: shared.clone(),
            packets: packets.clone(),
            news: news.clone(),
            waiting: None,
            measured_ns: None,
            sweeps: 0,
            skipped: 0,
            bad: 0,
        };
        let spawned = Builder::new()
            .name("receive".to_owned())
            .spawn(move || receiver.run(&first, buffer));
        spawned.map_err(Error::io(&name))?;
        Ok(Self {
            name,
            sensors: vec![sensor],
            notes,
            news,
            shared,
            packets,
            sweeps: 0,
        })
    }
}

/// Where a sensor sends what is not of returns, unless that is told.
fn usual_port_beside(model: Model, calibration: &Calibration) -> Option<u16> {
    match calibration {
        Calibration::Ouster(metadata) => Some(metadata.imu_port.unwrap_or(7503)),
        _ => (model.maker() == Maker::Velodyne).then_some(8308),
    }
}

/// Binds to another port of an address, without waiting for what comes there.
fn bind_beside(name: &str, address: &str, port: &str) -> Result<(UdpSocket, SocketAddr)> {
    let host = address.rsplit_once(':').map_or("", |(host, _)| host);
    let socket = bind(name, &format!("{host}:{port}"))?;
    socket.set_nonblocking(true).map_err(Error::io(name))?;
    let to = socket.local_addr().map_err(Error::io(name))?;
    Ok((socket, to))
}

fn bind(name: &str, address: &str) -> Result<UdpSocket> {
    let (host, port) = address.rsplit_once(':').unwrap_or(("", address));
    let port: Option<u16> = port.parse().ok().filter(|&port| port > 0);
    let port = port.ok_or_else(|| Error::dataset(name, "has no port: udp://:2368, or udp://HOST:2368"))?;
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let host = if host.is_empty() { "0.0.0.0" } else { host };
    let found = (host, port).to_socket_addrs().map_err(Error::io(name))?.next();
    let found = found.ok_or_else(|| Error::dataset(name, "is no address"))?;
    let group = Some(found.ip()).filter(IpAddr::is_multicast);
    let any = SocketAddr::new(Ipv4Addr::UNSPECIFIED.into(), port);
    let socket = UdpSocket::bind(if group.is_some() { any } else { found }).map_err(Error::io(name))?;
    if let Some(IpAddr::V4(group)) = group {
        socket
            .join_multicast_v4(&group, &Ipv4Addr::UNSPECIFIED)
            .map_err(Error::io(name))?;
    }
    socket.set_read_timeout(Some(LOOK_EVERY)).map_err(Error::io(name))?;
    Ok(socket)
}

/// A datagram, if one comes before it is time to look around.
fn receive(name: &str, socket: &UdpSocket, buffer: &mut [u8]) -> Result<Option<(usize, SocketAddr)>> {
    match socket.recv_from(buffer) {
        Ok(received) => Ok(Some(received)),
        Err(e)
            if matches!(
                e.kind(),
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
            ) =>
        {
            Ok(None)
        }
        // Somebody else's port was closed: no matter.
        Err(e) if e.kind() == ErrorKind::ConnectionReset => Ok(None),
        Err(e) => Err(Error::io(name)(e)),
    }
}

/// The thread that receives and decodes.
struct Receiver {
    name: String,
    socket: UdpSocket,
    to: SocketAddr,
    /// Where positions and samples come, and its address.
    beside: Option<(UdpSocket, SocketAddr)>,
    sender: SocketAddr,
    body_from_sensor: DQuat,
    decoder: Decoder,
    shared: Arc<Shared>,
    packets: Arc<Packets>,
    news: News,
    /// A sweep that waits for samples, with the time of its last return, and the time of the newest sample.
    waiting: Option<(Sweep, i64)>,
    measured_ns: Option<i64>,
    sweeps: u64,
    skipped: u64,
    bad: u64,
}

impl Receiver {
    fn run(mut self, first: &[u8], mut buffer: Vec<u8>) {
        self.take([self.sender, self.to], first);
        let mut last = Instant::now();
        while !self.shared.lock().is_unwanted && last.elapsed().as_secs() < SILENCE_SECS {
            match receive(&self.name, &self.socket, &mut buffer) {
                Ok(None) => {}
                Ok(Some((length, from))) => {
                    if from == self.sender {
                        last = Instant::now();
                    }
                    self.take([from, self.to], &buffer[..length]);
                }
                Err(reason) => {
                    self.news
                        .lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .push(reason.to_string());
                    break;
                }
            }
            for _ in 0..BESIDE {
                let Some((socket, to)) = &self.beside else { break };
                let Ok(Some((length, from))) = receive(&self.name, socket, &mut buffer) else {
                    break;
                };
                self.take([from, *to], &buffer[..length]);
            }
        }
        let sweep = self.decoder.finish();
        self.hold(sweep);
        self.give();
        self.tell();
        self.shared.lock().is_over = true;
        self.shared.changed.notify_all();
    }

    /// Takes what came: returns from the sender's port, samples and positions from any port of it.
    fn take(&mut self, ends: [SocketAddr; 2], packet: &[u8]) {
        let is_sender = ends[0] == self.sender;
        if ends[0].ip() != self.sender.ip() {
            return;
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let received_ns = i64::try_from(now.as_nanos()).unwrap_or(i64::MAX);
        let samples = self.decoder.imu(received_ns, packet);
        let is_beside = !samples.is_empty() || self.decoder.position(received_ns, packet).is_some();
        if is_sender || is_beside {
            self.packets.take(received_ns, ends, packet);
        }
        self.measure(samples);
        if is_sender {
            match self.decoder.push(received_ns, packet) {
                Ok(sweep) => self.hold(sweep),
                Err(_) => self.bad += 1,
            }
        }
        if let Some((_, end_ns)) = self.waiting
            && self.measured_ns.is_none_or(|ns| ns >= end_ns)
        {
            self.give();
        }
    }

    fn measure(&mut self, samples: Vec<ImuSample>) {
        let Some(newest) = samples.last() else { return };
        self.measured_ns = Some(newest.time_ns);
        let mut state = self.shared.lock();
        state.imu.extend(samples.into_iter().map(|sample| ImuSample {
            angular_velocity: self.body_from_sensor * sample.angular_velocity,
            acceleration: self.body_from_sensor * sample.acceleration,
            ..sample
        }));
        let old = state.imu.len().saturating_sub(MAX_SAMPLES);
        state.imu.drain(..old);
    }

    /// Keeps a sweep until its samples are there, or the next sweep is; the first and the last one only if they are not mostly missing.
    fn hold(&mut self, sweep: Option<Sweep>) {
        let Some(sweep) = sweep.filter(|sweep| sweep.is_whole || sweep.turn > 0.25) else {
            return;
        };
        if self.waiting.is_some() {
            // No samples come any more.
            self.measured_ns = None;
            self.give();
        }
        let end_ns = end_ns(&sweep);
        self.waiting = Some((sweep, end_ns));
    }

    /// Puts the sweep that waits where the reader finds it.
    fn give(&mut self) {
        let Some((sweep, _)) = self.waiting.take() else { return };
        self.sweeps += 1;
        let before = self.shared.lock().newest.replace(sweep);
        self.skipped += u64::from(before.is_some());
        self.shared.changed.notify_all();
        self.tell();
    }

    fn tell(&self) {
        let (counts, name) = (self.decoder.counts(), &self.name);
        let mut news = vec![format!(
            "{name}: {} packets, {} lost, {} late",
            counts.packets, counts.lost, counts.late
        )];
        if self.skipped > 0 {
            let (skipped, sweeps) = (self.skipped, self.sweeps);
            news.push(format!(
                "{name}: {skipped} of {sweeps} sweeps came faster than they could be fused: left out"
            ));
        }
        if self.bad > 0 {
            news.push(format!(
                "{name}: {} packets were none of this sensor's: left out",
                self.bad
            ));
        }
        *self.news.lock().unwrap_or_else(PoisonError::into_inner) = news;
    }
}

/// The time of a sweep's last return, nanoseconds on the sensor's clock.
fn end_ns(sweep: &Sweep) -> i64 {
    let times = sweep.scan.times.iter().flatten().copied();
    ns_after(sweep.scan.time_ns.unwrap_or(0), f64::from(times.fold(0.0, f32::max)))
}

impl Stream for Udp {
    fn format(&self) -> &str {
        "packets from the network"
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn next(&mut self) -> Option<StreamedScan> {
        let mut state = self.shared.lock();
        let sweep = loop {
            if let Some(sweep) = state.newest.take() {
                break sweep;
            }
            if state.is_over {
                return None;
            }
            state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        };
        drop(state);
        let mut scan = sweep.scan;
        scan.name = format!("{} sweep {}", self.name, self.sweeps);
        self.sweeps += 1;
        Some(StreamedScan {
            sensor: 0,
            scan: Ok(scan),
        })
    }

    fn imu(&mut self) -> Vec<ImuSample> {
        self.shared.lock().imu.drain(..).collect()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn news(&self) -> News {
        self.news.clone()
    }

    fn kept(&self) -> Option<Arc<dyn Kept>> {
        Some(self.packets.clone())
    }

    fn is_placed(&self) -> bool {
        false
    }
}

impl Drop for Udp {
    fn drop(&mut self) {
        self.shared.lock().is_unwanted = true;
    }
}

#[cfg(test)]
mod tests;
