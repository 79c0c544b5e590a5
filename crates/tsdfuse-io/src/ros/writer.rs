//! Saying scans in ROS 2's messages: clouds as `sensor_msgs/PointCloud2`, poses as tf.

use std::collections::BTreeMap;
use std::path::Path;

use tsdfuse::{Pose, Scan};

use super::mcap_file::McapFile;
use super::sink::Sink;
use super::told::Told;
use crate::error::{Error, Result};
use crate::point_rows;
use crate::source::{ImuSample, Sensor};

/// The frame in which the poses are.
pub(super) const WORLD: &str = "map";

/// Writes scans as an MCAP file, or says them to who listens, one after another: `PointCloud2` with the fields `x y z intensity time ring`, as far as the scans
/// have them, each sensor under a topic of its own, and its poses during each sweep as tf from `map`. Samples of an inertial measurement
/// unit become `Imu`.
///
/// Points, rings and times come back bit for bit, poses up to rounding. tf knows one pose at a time: where a sweep overlaps in time with the one
/// before and moves otherwise, its points are turned so that they keep their place in the world. A file appears when it is finished.
pub struct Writer {
    sink: Box<dyn Sink>,
    /// Channel, topic and frame of each sensor's clouds.
    clouds: Vec<(u16, String)>,
    tf: u16,
    /// Channels of other topics.
    others: BTreeMap<String, u16>,
    /// What was told of each sensor's way.
    told: Vec<Told>,
    scans: u64,
}

/// A message of CDR, little-endian.
pub(super) struct Cdr(Vec<u8>);

impl Cdr {
    pub(super) fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn align(&mut self, size: usize) {
        // Behind the header of four bytes.
        let len = 4 + (self.0.len() - 4).next_multiple_of(size);
        self.0.resize(len, 0);
    }

    pub(super) fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        self.align(N);
        self.0.extend(bytes);
    }

    pub(super) fn u32(&mut self, value: usize) {
        self.number(u32::try_from(value).unwrap_or(u32::MAX).to_le_bytes());
    }

    pub(super) fn text(&mut self, text: &str) {
        self.u32(text.len() + 1);
        self.0.extend(text.bytes());
        self.0.push(0);
    }

    pub(super) fn header(&mut self, time_ns: i64, frame: &str) {
        self.time(time_ns);
        self.text(frame);
    }

    pub(super) fn time(&mut self, time_ns: i64) {
        let secs = i32::try_from(time_ns.div_euclid(1_000_000_000)).unwrap_or(i32::MAX);
        self.number(secs.to_le_bytes());
        self.number((time_ns.rem_euclid(1_000_000_000) as u32).to_le_bytes());
    }

    /// A position, or translation, and a quaternion.
    pub(super) fn pose(&mut self, pose: &Pose) {
        let (p, q) = (pose.translation, pose.rotation);
        for v in [p.x, p.y, p.z, q.x, q.y, q.z, q.w] {
            self.number(v.to_le_bytes());
        }
    }

    pub(super) fn color(&mut self, [r, g, b]: [f32; 3]) {
        for v in [r, g, b, 1.0] {
            self.number(v.to_le_bytes());
        }
    }

    pub(super) fn byte(&mut self, byte: u8) {
        self.0.push(byte);
    }
}

impl Writer {
    /// Begins a file for scans of these sensors.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn create(path: impl AsRef<Path>, sensors: &[Sensor]) -> Result<Self> {
        Self::over(Box::new(McapFile::create(path.as_ref())?), sensors)
    }

    /// Says scans of these sensors to the clients of a server.
    ///
    /// # Errors
    /// Names the server and what is wrong.
    #[cfg(feature = "serve")]
    pub fn to(server: &super::Server, sensors: &[Sensor]) -> Result<Self> {
        Self::over(Box::new(server.sink()), sensors)
    }

    fn over(mut sink: Box<dyn Sink>, sensors: &[Sensor]) -> Result<Self> {
        let tf = sink.channel("/tf", "tf2_msgs/TFMessage")?;
        let mut clouds = Vec::new();
        for sensor in sensors {
            let name = sensor.name.trim_start_matches('/');
            let id = sink.channel(&format!("/{name}"), "sensor_msgs/PointCloud2")?;
            clouds.push((id, name.replace('/', "_")));
        }
        Ok(Self {
            sink,
            told: clouds.iter().map(|_| Told::default()).collect(),
            clouds,
            tf,
            others: BTreeMap::new(),
            scans: 0,
        })
    }

    pub(super) fn write(&mut self, channel: u16, time_ns: i64, message: Cdr) -> Result<()> {
        let time_ns =
            u64::try_from(time_ns).map_err(|_| Error::format(self.path(), "MCAP has no times before 1970"))?;
        self.sink.send(channel, time_ns, message.0)
    }

    fn path(&self) -> &Path {
        self.sink.path()
    }

    /// The channel of a topic with messages of one kind, which is made where it is not there yet.
    pub(super) fn channel(&mut self, topic: &str, kind: &str) -> Result<u16> {
        if let Some(channel) = self.others.get(topic) {
            return Ok(*channel);
        }
        let channel = self.sink.channel(topic, kind)?;
        self.others.insert(topic.to_owned(), channel);
        Ok(channel)
    }

    pub(super) fn known_channel(&self, topic: &str) -> Option<u16> {
        self.others.get(topic).copied()
    }

    pub(super) fn is_heard(&self, channel: u16) -> bool {
        self.sink.is_heard(channel)
    }

    pub(super) fn has_newcomers(&mut self, channel: u16) -> bool {
        self.sink.has_newcomers(channel)
    }

    /// The frame of the first sensor.
    pub(super) fn frame(&self) -> String {
        self.clouds
            .first()
            .map_or("sensor".to_owned(), |(_, frame)| frame.clone())
    }

    /// When a scan without a time is said to be: a tenth of a second after the one before.
    pub fn time_ns(&self, scan: &Scan) -> i64 {
        scan.time_ns.unwrap_or(1_000_000_000 + self.scans as i64 * 100_000_000)
    }

    /// Writes the next scan of a sensor, by its number.
    ///
    /// # Errors
    /// Names the file and what the system says, or the scan and what it lacks.
    pub fn write_scan(&mut self, sensor: usize, scan: &Scan) -> Result<()> {
        scan.check().map_err(|e| Error::dataset(self.path(), e.to_string()))?;
        let (channel, frame) = self.clouds.get(sensor).cloned().ok_or_else(|| {
            Error::dataset(
                self.path(),
                format!("{} is of a sensor that was not told of", scan.name),
            )
        })?;
        let time_ns = self.time_ns(scan);
        self.scans += 1;
        let followed = self.told.get_mut(sensor).map(|told| told.follow(time_ns, scan));
        let (poses, points) = followed.unwrap_or_default();
        for (time_ns, pose) in poses {
            let mut message = Cdr::new();
            message.u32(1);
            message.header(time_ns, WORLD);
            message.text(&frame);
            message.pose(&pose);
            self.write(self.tf, time_ns, message)?;
        }
        let turned = points.map(|points| Scan { points, ..scan.clone() });
        self.write(
            channel,
            time_ns,
            cloud(turned.as_ref().unwrap_or(scan), time_ns, &frame),
        )
    }

    /// Writes what an inertial measurement unit measured, in the frame of the first sensor.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn write_imu(&mut self, samples: &[ImuSample]) -> Result<()> {
        let Some((_, frame)) = self.clouds.first().cloned() else {
            return Ok(());
        };
        let channel = self.channel("/imu", "sensor_msgs/Imu")?;
        for sample in samples {
            let mut message = Cdr::new();
            message.header(sample.time_ns, &frame);
            // No orientation, which its covariance says.
            let mut numbers = vec![0.0, 0.0, 0.0, 1.0];
            numbers.extend([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            numbers.extend(sample.angular_velocity.to_array());
            numbers.extend([0.0; 9]);
            numbers.extend(sample.acceleration.to_array());
            numbers.extend([0.0; 9]);
            for number in numbers {
                message.number(f64::to_le_bytes(number));
            }
            self.write(channel, sample.time_ns, message)?;
        }
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn finish(self) -> Result<()> {
        self.sink.finish()
    }
}

fn cloud(scan: &Scan, time_ns: i64, frame: &str) -> Cdr {
    let count = scan.points.len();
    let columns = point_rows::columns(scan);
    let mut message = Cdr::new();
    message.header(time_ns, frame);
    message.u32(1);
    message.u32(count);
    message.u32(columns.len());
    let mut stride = 0;
    for (name, scalar) in &columns {
        message.text(name);
        message.u32(stride);
        // PointField.FLOAT32 and .UINT16
        message.0.push(if scalar.is_integer() { 4 } else { 7 });
        message.u32(1);
        stride += scalar.size();
    }
    message.0.push(0);
    message.u32(stride);
    message.u32(stride * count);
    message.u32(stride * count);
    point_rows::append(scan, &mut message.0);
    message.0.push(1);
    message
}
