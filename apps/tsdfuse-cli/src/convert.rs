//! `tsdfuse convert`: a log in another format.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::ValueEnum;
use tsdfuse::Scan;
use tsdfuse_io::plain::{self, Layout};
use tsdfuse_io::{Log, ReadScan, Selection, Sensor, ros};
use tsdfuse_run::{Input, Settings, check_outputs};

use crate::args::SensorArgs;
use crate::exit::{self, Outcome, Usage};
use crate::progress::{self, note, say};
use crate::terminal::Terminal;

const EXAMPLES: &str = "\
Examples:
  tsdfuse convert drive.bag -o drive.mcap
  tsdfuse convert drive.bag -o drive --sensor /velodyne_points
  tsdfuse convert pandaset/002 -o kitti --format kitti --undistorted";

/// Write a log in another format.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The log to read.
    log: PathBuf,
    /// A new folder, or a file that ends in .mcap.
    #[arg(short, long, value_name = "DIR|FILE.mcap")]
    output: PathBuf,
    /// How the scans lie in the folder.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// Move each point to where the sensor would have seen it at its scan's time, and leave out times and motion.
    #[arg(long)]
    undistorted: bool,
    /// Only these scans, counted from 0, TO excluded; every STEP-th of them [default: all].
    #[arg(long, value_name = "FROM..TO[:STEP]")]
    scans: Option<Selection>,
    /// The poses: a file (TUM, KITTI, CSV, g2o), or a topic or frame of a ROS bag [default: the log's].
    #[arg(long, value_name = "FILE|TOPIC|FRAME")]
    poses: Option<PathBuf>,
    #[command(flatten)]
    sensor: SensorArgs,
    /// Skip scans that cannot be read; they are listed, and the exit code is 3.
    #[arg(long)]
    skip_bad: bool,
}

/// What is written into a folder.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum Format {
    /// velodyne/*.bin with rings, times and motion beside them.
    #[default]
    Plain,
    /// *.pcd with rings and times, and motion.txt.
    Pcd,
    /// velodyne/*.bin and poses.txt, as KITTI odometry; always undistorted.
    Kitti,
}

/// What is written to.
enum Writer {
    Folder(plain::Writer),
    Mcap(Box<ros::Writer>),
}

impl Writer {
    fn create(args: &Args, sensors: &[Sensor]) -> Result<Self> {
        if args
            .output
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("mcap"))
        {
            return Ok(Self::Mcap(Box::new(ros::Writer::create(&args.output, sensors)?)));
        }
        let layout = match args.format {
            Format::Plain => Layout::Plain,
            Format::Pcd => Layout::Pcd,
            Format::Kitti => Layout::Kitti,
        };
        if let [first, _, ..] = sensors {
            let names: Vec<_> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
            let told = format!(
                "{} has the scans of {}, and a folder holds those of one: choose it with --sensor {}, or write to a .mcap",
                args.log.display(),
                names.join(", "),
                first.name
            );
            return Err(Usage::new(told).into());
        }
        let mut writer = plain::Writer::create_as(&args.output, layout)?;
        let model = sensors.first().and_then(|sensor| sensor.model.as_ref());
        if let Some(model) = model.filter(|_| layout != Layout::Kitti) {
            writer.write_sensor(model)?;
        }
        Ok(Self::Folder(writer))
    }

    fn write(&mut self, sensor: usize, scan: &Scan) -> tsdfuse_io::Result<()> {
        match self {
            Self::Folder(writer) => writer.write_scan(scan),
            Self::Mcap(writer) => writer.write_scan(sensor, scan),
        }
    }

    /// Writes the samples of the log's inertial measurement unit, if there are any.
    fn write_imu(&mut self, log: &Log) -> tsdfuse_io::Result<()> {
        let mut samples = log.imu()?;
        let Some(sensor) = log.sensors().first().filter(|_| !samples.is_empty()) else {
            return Ok(());
        };
        let sensor_from_body = sensor.body_from_sensor.rotation.inverse();
        for sample in &mut samples {
            sample.angular_velocity = sensor_from_body * sample.angular_velocity;
            sample.acceleration = sensor_from_body * sample.acceleration;
        }
        match self {
            Self::Folder(writer) => writer.write_imu(&samples),
            Self::Mcap(writer) => writer.write_imu(&samples),
        }
    }

    fn finish(self) -> tsdfuse_io::Result<()> {
        match self {
            Self::Folder(writer) => writer.finish(),
            Self::Mcap(writer) => writer.finish(),
        }
    }
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    check_outputs(&[&args.log], &[&args.output])?;
    let input = Input {
        path: args.log.clone(),
        options: args.sensor.options(args.poses.clone()),
        selection: args.scans.clone().unwrap_or_default(),
        skip_bad: args.skip_bad,
    };
    let log = input.open_unplaced(&Settings::default(), &mut Terminal::default())?;
    let mut writer = Writer::create(args, log.sensors())?;
    let undistorted = args.undistorted || matches!(args.format, Format::Kitti) && matches!(writer, Writer::Folder(_));
    let stop = exit::stop_on_interrupt()?;
    let bar = progress::scans("writing", log.len());
    let (mut written, mut skipped) = (0u64, 0);
    for ReadScan { sensor, scan, .. } in log.read_ahead(&input.selection) {
        match scan {
            Ok(mut scan) => {
                if undistorted {
                    scan.undistort();
                }
                writer.write(sensor, &scan)?;
                written += 1;
            }
            Err(error) if args.skip_bad => {
                note(error);
                skipped += 1;
            }
            Err(error) => return Err(error).context("--skip-bad leaves such scans out"),
        }
        bar.inc(1);
        if stop.is_stopped() {
            break;
        }
    }
    drop(bar);
    if !matches!(args.format, Format::Kitti) || matches!(writer, Writer::Mcap(_)) {
        writer.write_imu(&log)?;
    }
    writer.finish()?;
    say(format_args!("{written} scans in {}", args.output.display()));
    Ok(if skipped > 0 || stop.is_stopped() {
        Outcome::ScansSkipped
    } else {
        Outcome::Complete
    })
}
