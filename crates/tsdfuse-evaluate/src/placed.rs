//! A log with poses of each kind that is asked for.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::{Log, Selection, sensor_file};
use tsdfuse_run::{Event, Input, RunError, Stop, Track, common_shift, refine, track, write_poses};

use crate::contest::Contest;
use crate::error::{Error, Result};
use crate::pose_noise::PoseNoise;
use crate::progress::{Progress, Runs, Watch};
use crate::scan_poses::ScanPoses;

/// A log with poses of one kind.
pub(crate) struct PlacedLog {
    pub(crate) poses: ScanPoses,
    /// What is fused, with noise if that is asked for.
    pub(crate) input: Input,
    /// Without noise.
    pub(crate) log: Log,
}

/// The log with each kind of poses that the methods ask for; files of poses go to a folder, which must stay.
pub(crate) fn logs(contest: &Contest, folder: &Path, watch: &mut Watch<'_>) -> Result<Vec<PlacedLog>> {
    let mut all: Vec<PlacedLog> = Vec::new();
    for kind in ScanPoses::ALL {
        if contest.forms.iter().any(|form| form.poses == kind) {
            let (input, log) = match kind {
                ScanPoses::Given => (
                    contest.input.clone(),
                    contest.input.open(&contest.settings, &mut Runs(watch))?,
                ),
                ScanPoses::Refine | ScanPoses::Track => found(kind, contest, folder, watch)?,
            };
            let input = match contest.pose_noise {
                Some(noise) => noisy(noise, kind, input, &log, contest, folder)?,
                None => input,
            };
            let poses = kind;
            all.push(PlacedLog { poses, input, log });
        }
    }
    Ok(all)
}

/// What is fused with noise added to the poses of a log.
fn noisy(
    noise: PoseNoise,
    kind: ScanPoses,
    mut input: Input,
    log: &Log,
    contest: &Contest,
    folder: &Path,
) -> Result<Input> {
    if log.sensors().len() != 1 {
        return Err(Error::config("--pose-noise needs one sensor: choose it with --sensor"));
    }
    let poses = log.scans().iter().enumerate().map(|(index, scan)| {
        let pose = scan.pose.ok_or_else(|| {
            Error::config(format_args!(
                "--pose-noise needs poses of all scans, and {} has none",
                scan.name
            ))
        })?;
        Ok(FusedPose {
            pose: noise.add(index, pose),
            time_ns: scan.time_ns,
        })
    });
    let path = folder.join(format!("{}-noisy.poses", kind.name()));
    write_poses(&path, &poses.collect::<Result<Vec<_>>>()?)?;
    input.options.poses = Some(path);
    input.open(&contest.settings, &mut |_: Event<'_>| {})?;
    Ok(input)
}

/// The log with refined or tracked poses, those of scans that are held out included.
fn found(kind: ScanPoses, contest: &Contest, folder: &Path, watch: &mut Watch<'_>) -> Result<(Input, Log)> {
    watch(Progress::At(match kind {
        ScanPoses::Track => "tracking",
        ScanPoses::Given | ScanPoses::Refine => "refining poses",
    }));
    let mut observer = Runs(watch);
    let log = match kind {
        ScanPoses::Track => contest.input.open_unplaced(&contest.settings, &mut observer)?,
        ScanPoses::Given | ScanPoses::Refine => contest.input.open(&contest.settings, &mut observer)?,
    };
    let config = contest.settings.resolve(&log)?;
    // As `fuse` does by default.
    let (odometry, loops) = (config.odometry, Some(config.loops));
    let (range, stop) = (config.range, Stop::default());
    let all = Selection {
        hold_out: None,
        ..contest.input.selection.clone()
    };
    let Track { scans, correction, .. } = match kind {
        ScanPoses::Track => track(&log, &all, odometry, loops, range, &stop)?,
        ScanPoses::Given | ScanPoses::Refine => refine(&log, &all, odometry, loops, range, &stop, &mut observer)?,
    };
    let given = scans
        .iter()
        .filter_map(|scan| Some((log.scans().get(scan.index)?.pose?, scan.pose.pose)));
    let shift = match kind {
        ScanPoses::Track => common_shift(&given.collect::<Vec<_>>()),
        ScanPoses::Given | ScanPoses::Refine => Pose::IDENTITY,
    };
    let poses = scans.iter().map(|scan| FusedPose {
        pose: shift * scan.pose.pose,
        ..scan.pose
    });
    let path = folder.join(format!("{}.poses", kind.name()));
    write_poses(&path, &poses.collect::<Vec<_>>())?;
    let mut input = contest.input.clone();
    input.options.poses = Some(path);
    let mut settings = contest.settings.clone();
    if let (Some(correction), Some(mut sensor)) = (correction, log.sensors().first().cloned()) {
        sensor.correction = sensor.correction.plus(&correction);
        let path = folder.join(format!("{}.toml", kind.name()));
        sensor_file::write(&path, &sensor).map_err(RunError::from)?;
        input.options.sensor_file = Some(path);
        // The file has what is set, too.
        settings = settings.without("sensor");
    }
    let log = input
        .open(&settings, &mut |_: Event<'_>| {})
        .map_err(|error| Error::failed(format_args!("the poses that were found do not fit the log: {error}")))?;
    Ok((input, log))
}
