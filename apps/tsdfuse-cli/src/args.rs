//! Arguments that several subcommands share: what to fuse, and with what.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use clap::builder::{PossibleValuesParser, RangedI64ValueParser};
use glam::{DQuat, DVec2, DVec3};
use tsdfuse::fuse::Method;
use tsdfuse::mesh::MeshConfig;
use tsdfuse::scan::RangeLimits;
use tsdfuse::{MapConfig, Pose};
use tsdfuse_io::{
    DEPTH_CAMERA_MAX_RANGE_M, DEPTH_CAMERA_TRUNCATION_M, DEPTH_CAMERA_VOXEL_SIZE_M, OpenOptions, Selection,
};
use tsdfuse_run::{Device, Input, Job, PosesFrom, Settings};

use crate::exit::Usage;
use crate::program::command_line;

/// The log and the settings.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LogArgs {
    /// The log to read; its format (ROS bag, MCAP, PCAP, PandaSet, KITTI, nuScenes, plain folder, ...) is detected. udp://:PORT is a
    /// LiDAR that sends packets now, - an MCAP file through standard input.
    #[arg(value_name = "LOG")]
    pub(crate) log: PathBuf,
    #[arg(long, value_name = "M",
        help = format!("Voxel size, metres [default: {}, or {DEPTH_CAMERA_VOXEL_SIZE_M} for depth cameras]",
            MapConfig::default().voxel_size_m))]
    pub(crate) voxel_size: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Truncation distance (half the width of the band around the surface), metres [default: {}, or {DEPTH_CAMERA_TRUNCATION_M} for depth cameras]",
            MapConfig::default().truncation_m))]
    pub(crate) truncation: Option<f64>,
    /// Fuse only these scans, counted from 0, TO excluded; every STEP-th of them [default: all].
    #[arg(long, value_name = "FROM..TO[:STEP]")]
    pub(crate) scans: Option<Selection>,
    /// Where poses come from: a file (TUM, KITTI, CSV, g2o), a topic or frame of a ROS bag, the log, or odometry [default:
    /// the log, or odometry if it has none]. With refine (the log's) or refine:FILE, each scan is registered to what the
    /// others saw.
    #[arg(long, value_name = "FILE|NAME|log|track|refine")]
    pub(crate) poses: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) sensor: SensorArgs,
    #[arg(long, value_name = "M",
        help = format!("Drop returns nearer than this, metres [default: the log's, or {}]", RangeLimits::default().min_range_m))]
    pub(crate) min_range: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Drop returns farther than this, metres [default: the sensor's, {DEPTH_CAMERA_MAX_RANGE_M} for depth cameras, or {}]",
            RangeLimits::default().max_range_m))]
    pub(crate) max_range: Option<f64>,
    /// Number of threads; does not change the result [default: one for each core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
    #[arg(
        long,
        value_name = "W",
        help = format!("Extract no surface from voxels with less weight than this [default: {}]", MeshConfig::default().min_weight)
    )]
    pub(crate) min_weight: Option<f64>,
    /// Read settings from a TOML file.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Set one key of the configuration, for instance raycast.distance=projective.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// The recording is still being written: read its scans as they come, until it is closed or stands still for 10 s.
    #[arg(long)]
    pub(crate) follow: bool,
    /// Skip scans that cannot be used; they are listed, and the exit code is 3.
    #[arg(long)]
    pub(crate) skip_bad: bool,
}

/// A run: what is fused, how, and where.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RunArgs {
    #[arg(long, value_parser = PossibleValuesParser::new(Method::ALL.iter().map(|m| m.name())),
        help = format!("The fusion method [default: {}, or depth for depth cameras]", Method::default().name()))]
    method: Option<String>,
    /// Fuse on the CPU or a GPU (gpu:NAME: the one whose name contains NAME).
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    pub(crate) device: Device,
    /// Correct the poses that odometry finds, or that are refined, where the sensor comes back, before anything is fused; of a stream when it is over.
    #[arg(long, value_name = "on|off", default_value = "on")]
    loops: Loops,
    /// What becomes of returns of things that move, those in space that was known to be free [default: leave-out with the method patch,
    /// else fuse].
    #[arg(long, value_name = "leave-out|fuse")]
    moving: Option<MovingReturns>,
    #[command(flatten)]
    pub(crate) log: LogArgs,
}

impl RunArgs {
    /// The run, without outputs.
    pub(crate) fn job(&self) -> Result<Job> {
        let mut settings = self.log.settings(self.method.as_deref())?;
        if let Some(moving) = self.moving {
            settings.set(
                "--moving",
                "moving.leave_out",
                matches!(moving, MovingReturns::LeaveOut),
            )?;
        }
        Ok(Job {
            input: self.log.input(),
            poses: self.log.poses_from(),
            open_loops: !self.loops.is_on(),
            settings,
            device: self.device.clone(),
            command_line: command_line(),
            config_file: self.log.config.clone(),
            ..Job::default()
        })
    }
}

/// Which sensors of a log are read, and what is known of them.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct SensorArgs {
    /// Where the sensor sits on the body whose poses are used: a file with the 3x4 matrix, or x,y,z,qx,qy,qz,qw (metres, quaternion)
    /// [default: as the log tells].
    #[arg(long, value_name = "FILE|POSE", value_parser = parse_extrinsics, allow_hyphen_values = true)]
    extrinsics: Option<Pose>,
    /// The sensor: one of several in the log (several with commas are read together), the model of the only one
    /// (pandar64, hdl64e, vlp16, ...), or a file that tells its errors and where it sits (see --save-sensor).
    #[arg(long, value_name = "NAME|FILE.toml", value_delimiter = ',')]
    sensor: Vec<String>,
    /// The calibration of a LiDAR whose packets are read: Velodyne's XML or YAML, Hesai's CSV, Ouster's metadata [default: what
    /// fits and lies beside the recording, or the model's nominal angles].
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

impl SensorArgs {
    /// How the log is opened, with these poses.
    pub(crate) fn options(&self, poses: Option<PathBuf>) -> OpenOptions {
        let is_file = |name: &&String| name.ends_with(".toml");
        let names = self.sensor.iter().filter(|name| !is_file(name));
        let mut files = self.sensor.iter().filter(is_file);
        OpenOptions {
            poses,
            sensors: names.cloned().collect(),
            sensor_file: files.next().map(PathBuf::from),
            calibration: self.calibration.clone(),
            extrinsics: self.extrinsics,
            ..OpenOptions::default()
        }
    }
}

impl LogArgs {
    /// Where the poses come from.
    pub(crate) fn poses_from(&self) -> PosesFrom {
        match self.poses.as_deref().and_then(Path::to_str) {
            None => PosesFrom::Any,
            Some("track") => PosesFrom::Track,
            Some(text) if text == "refine" || text.starts_with(REFINE_FILE) => PosesFrom::Refine,
            Some(_) => PosesFrom::Log,
        }
    }

    /// Refuses odometry, for commands that compare what is made of one trajectory.
    pub(crate) fn check_poses_known(&self) -> Result<()> {
        let word = match self.poses_from() {
            PosesFrom::Track => "track",
            PosesFrom::Refine => "refine",
            PosesFrom::Any | PosesFrom::Log => return Ok(()),
        };
        Err(Usage::new(format!("--poses {word}: this command needs poses that are known; write them with `tsdfuse odometry LOG --poses {word} -o poses.tum`")).into())
    }

    /// The log and which of its scans.
    pub(crate) fn input(&self) -> Input {
        Input {
            path: self.log.clone(),
            options: OpenOptions {
                follow: self.follow,
                ..self.sensor.options(self.poses.as_deref().and_then(pose_file))
            },
            selection: self.scans.clone().unwrap_or_default(),
            skip_bad: self.skip_bad,
        }
    }

    /// All that is set: the file < `--set` < flags.
    pub(crate) fn settings(&self, method: Option<&str>) -> Result<Settings> {
        let file = self.config.as_deref().map(Settings::read).transpose()?;
        let mut settings = file.unwrap_or_default();
        for setting in &self.set {
            settings.set_text(setting)?;
        }
        if let Some(method) = method {
            settings.set("--method", "method", method)?;
        }
        let numbers = [
            ("--voxel-size", "map.voxel_size_m", self.voxel_size),
            ("--truncation", "map.truncation_m", self.truncation),
            ("--min-range", "range.min_range_m", self.min_range),
            ("--max-range", "range.max_range_m", self.max_range),
            ("--min-weight", "mesh.min_weight", self.min_weight),
        ];
        for (flag, key, value) in numbers {
            if let Some(value) = value {
                settings.set(flag, key, value)?;
            }
        }
        Ok(settings)
    }

    pub(crate) fn set_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().with_context(|| format!("--threads {threads}"))
    }
}

/// The file that `--poses` names, if it names one.
fn pose_file(poses: &Path) -> Option<PathBuf> {
    match poses.to_str() {
        Some("log" | "track" | "refine") => None,
        Some(text) => Some(text.strip_prefix(REFINE_FILE).unwrap_or(text).into()),
        None => Some(poses.to_owned()),
    }
}

/// `--poses` with this before a file's name refines its poses.
const REFINE_FILE: &str = "refine:";

/// A pose: seven numbers with commas between them, or a file with a matrix.
pub(crate) fn parse_extrinsics(text: &str) -> Result<Pose, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z, qx, qy, qz, qw]) => {
            Pose::new(DQuat::from_xyzw(qx, qy, qz, qw).normalize(), DVec3::new(x, y, z)).map_err(|e| e.to_string())
        }
        Some(_) => Err("seven numbers are wanted: x,y,z in metres and a quaternion qx,qy,qz,qw".to_owned()),
        None => match tsdfuse_io::poses::read_all(text).map_err(|e| e.to_string())?.as_slice() {
            [pose] => Ok(*pose),
            poses => Err(format!("{text}: one pose is wanted, and it has {}", poses.len())),
        },
    }
}

/// A pose that is roughly known: three numbers, four with the turn about the vertical axis in degrees, or as [`parse_extrinsics`].
pub(crate) fn parse_rough_pose(text: &str) -> Result<Pose, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let upright = |x, y, z, yaw: f64| {
        Pose::new(DQuat::from_rotation_z(yaw.to_radians()), DVec3::new(x, y, z)).map_err(|e| e.to_string())
    };
    match numbers.as_deref() {
        Some(&[x, y, z]) => upright(x, y, z, 0.0),
        Some(&[x, y, z, yaw]) => upright(x, y, z, yaw),
        _ => parse_extrinsics(text),
    }
}

/// What becomes of returns of things that move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MovingReturns {
    LeaveOut,
    Fuse,
}

/// Whether loops are closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Loops {
    // Where the sensor comes back, its way is corrected.
    On,
    // Poses stay as odometry found them.
    Off,
}

impl Loops {
    pub(crate) fn is_on(self) -> bool {
        self == Self::On
    }
}

/// What `--hold-out` may be.
pub(crate) fn hold_out_range() -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(2..)
}

/// Three numbers with commas between them.
pub(crate) fn parse_triple(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if DVec3::new(x, y, z).is_finite() => Ok(DVec3::new(x, y, z)),
        _ => Err("three numbers with commas between them are wanted, as in 691000,5335000,520".to_owned()),
    }
}

/// Two numbers with a comma between them.
pub(crate) fn parse_pair(text: &str) -> Result<DVec2, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y]) if DVec2::new(x, y).is_finite() => Ok(DVec2::new(x, y)),
        _ => Err("two numbers with a comma between them are wanted, as in 12.5,-3".to_owned()),
    }
}

/// Bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Memory(pub(crate) usize);

impl FromStr for Memory {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || "a size is wanted, as in 512M or 8G".to_owned();
        let units = [('K', 10), ('M', 20), ('G', 30), ('T', 40)];
        let unit = units
            .iter()
            .find(|(unit, _)| text.to_ascii_uppercase().ends_with(*unit));
        let number = unit.map_or(text, |_| &text[..text.len() - 1]);
        let bytes =
            number.trim().parse::<f64>().map_err(|_| wanted())? * unit.map_or(1.0, |(_, bits)| f64::from(*bits).exp2());
        if bytes >= f64::from(1 << 20) && bytes < f64::from(1 << 30) * 1e6 {
            Ok(Self(bytes as usize))
        } else {
            Err("at least 1M is wanted".to_owned())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triples_are_three_numbers() {
        assert_eq!(parse_triple("1, -2,3e5"), Ok(DVec3::new(1.0, -2.0, 3e5)));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(parse_triple(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn extrinsics_are_seven_numbers_or_a_file() {
        let pose = parse_extrinsics("0.5,0,-1.5, 0,0,0,2").unwrap();
        assert_eq!(
            (pose.translation, pose.rotation),
            (DVec3::new(0.5, 0.0, -1.5), DQuat::IDENTITY)
        );
        for bad in ["1,2,3", "0,0,0,0,0,0,0", "no/such/file"] {
            assert!(parse_extrinsics(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn sizes_have_units() {
        let bytes = |text: &str| text.parse::<Memory>().map(|m| m.0);
        assert_eq!(bytes("512M"), Ok(512 << 20));
        assert_eq!(bytes("1.5g"), Ok(3 << 29));
        assert_eq!(bytes("2000000"), Ok(2_000_000));
        for bad in ["", "M", "-1G", "5", "nanG", "1e30G", "G5"] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
    }
}
