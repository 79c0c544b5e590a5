//! Pictures of what methods make of one scan, as the thesis draws them.

use std::path::Path;

use anyhow::Result;
use tsdfuse::Pose;
use tsdfuse::fuse::FuseConfig;
use tsdfuse::fuse::pictures::Picture;
use tsdfuse_run::check_outputs;

use super::name;
use crate::exit::{Outcome, Usage};
use crate::progress::{note, say};

/// Draws scan `number` of a log.
pub(super) fn run(log: &Path, number: usize, pictures: &[Picture], output: &Path) -> Result<Outcome> {
    tsdfuse_io::png::check(output).map_err(Usage::new)?;
    check_outputs(&[log], &[output])?;
    let log = tsdfuse_io::open(log)?;
    log.notes().iter().for_each(note);
    let sensor = log.scans().get(number).and_then(|scan| log.sensors().get(scan.sensor));
    let mut scan = log.read(number)?;
    scan.drop_invalid(&log.suggested().range);
    scan.pose.get_or_insert(Pose::IDENTITY);
    for &picture in pictures {
        let path = name::of(output, (0, 1), (picture.name(), pictures.len()));
        let model = sensor.and_then(|sensor| sensor.model.as_ref());
        tsdfuse_io::png::write(&path, &picture.of(&scan, &FuseConfig::default(), model)?)?;
        say(format_args!("  wrote    {}", path.display()));
    }
    Ok(Outcome::Complete)
}
