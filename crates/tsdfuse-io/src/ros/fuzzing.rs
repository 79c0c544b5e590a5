//! Feeds the parsers of recordings with arbitrary bytes.

use std::path::Path;

use super::bag1::Bag1;
use super::container::{Container, Encoding, RandomFile};
use super::frames::Frames;
use super::mcap::McapFile;
use super::point_times::PointTimes;
use super::points::Columns;
use super::schema::{Schema, known};
use super::value::{self, Rows, Value};
use super::{images, messages};
use crate::error::Result;

const PATH: &str = "input";
const KINDS: [&str; 12] = [
    "sensor_msgs/PointCloud2",
    "livox_ros_driver2/CustomMsg",
    "tf2_msgs/TFMessage",
    "nav_msgs/Odometry",
    "nav_msgs/Path",
    "geometry_msgs/PoseStamped",
    "sensor_msgs/Imu",
    "sensor_msgs/NavSatFix",
    "sensor_msgs/Image",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/CameraInfo",
    "velodyne_msgs/VelodyneScan",
];

fn file(bytes: &[u8]) -> RandomFile {
    RandomFile::of_bytes(Path::new(PATH), bytes.to_vec())
}

fn read_all(container: Result<impl Container>) {
    let Ok(container) = container else { return };
    for channel in 0..container.channels().len() {
        for entry in container.entries(channel).iter().take(100) {
            let _ = container.read(entry, 64);
            let _ = container.read(entry, usize::MAX);
        }
    }
}

/// An MCAP file.
pub(crate) fn mcap(bytes: &[u8]) {
    read_all(McapFile::open(file(bytes)));
}

/// A ROS 1 bag.
pub(crate) fn bag1(bytes: &[u8]) {
    read_all(Bag1::open(file(bytes)));
}

/// A message of each type that is known; and, where the bytes have a zero in them, a message behind it by the definition before it.
pub(crate) fn message(bytes: &[u8]) {
    for kind in KINDS {
        let schema = known(kind).and_then(|text| Schema::parse(kind, &text).ok());
        let Some(schema) = schema else { continue };
        for encoding in [Encoding::Ros1, Encoding::Cdr] {
            take(&value::read(&schema, encoding, bytes));
        }
    }
    let middle = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    let (text, data) = bytes.split_at(middle);
    if let Ok(schema) = Schema::parse("any/Any", &String::from_utf8_lossy(text)) {
        for encoding in [Encoding::Ros1, Encoding::Cdr] {
            take(&value::read(&schema, encoding, data.get(1..).unwrap_or_default()));
        }
    }
}

fn take(message: &Result<Value<'_>, String>) {
    let Ok(message) = message else { return };
    let _ = messages::header(message);
    let _ = messages::stamped_pose(message);
    let _ = messages::imu(message);
    let _ = messages::fix(message);
    let _ = messages::camera(message);
    let _ = images::encoded(message);
    let mut frames = Frames::default();
    let poses = messages::transforms(message).unwrap_or_default();
    for p in poses.into_iter().chain(messages::path(message).unwrap_or_default()) {
        frames.add(&p.parent, &p.child, p.time_ns, p.pose, p.time_ns % 2 == 0);
    }
    let _ = frames.worlds("a").and_then(|_| frames.trajectory("b", "a"));
    let _ = value::cloud(message).map(|rows| points(&rows));
    if let Ok(Value::Records(records)) = message.get("points") {
        points(&Rows::one(records.clone()));
    }
}

fn points(rows: &Rows<'_>) {
    let Ok(columns) = Columns::find(rows) else { return };
    let sightings: Vec<_> = columns.sighting(rows, 1_600_000_000_000_000_000).into_iter().collect();
    let times = PointTimes::infer(&sightings, 0.1).ok();
    if let Ok(read) = columns.read(rows, times.as_ref(), 0) {
        assert_eq!(read.points.len(), rows.len(), "as many points as were told");
    }
}
