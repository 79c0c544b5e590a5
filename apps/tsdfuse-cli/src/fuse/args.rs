//! The arguments of `tsdfuse fuse`, and what they mean.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use clap::ArgGroup;
use clap::builder::PossibleValuesParser;
use tsdfuse::MapConfig;
use tsdfuse::fuse::Method;
use tsdfuse::mesh::MeshConfig;
use tsdfuse::scan::RangeLimits;

use crate::config::{DEPTH_CAMERA_MAX_RANGE_M, DEPTH_CAMERA_TRUNCATION_M, DEPTH_CAMERA_VOXEL_SIZE_M, Layers};
use crate::exit::Usage;
use crate::output;
use crate::progress::note;

const EXAMPLES: &str = "\
Examples:
  tsdfuse fuse pandaset/002 -o street.ply
  tsdfuse fuse kitti/sequences/00 -o street.ply --scans 0..80 --voxel-size 0.1 --truncation 0.3
  tsdfuse fuse pandaset/002 --save-map street.tsdf
  tsdfuse fuse street -o street.ply --config run.toml --set raycast.distance=projective

Settings: defaults < --config < --set < flags. A report holds all of them.";

/// Fuse scans into a map and extract its surface.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, group(ArgGroup::new("result").args(["output", "save_map", "preview"]).required(true).multiple(true)))]
pub(crate) struct Args {
    /// The data set; its format (PandaSet, KITTI, a plain folder, RGB-D, ...) is recognised.
    pub(super) dataset: PathBuf,
    /// The mesh to write, .ply, .glb or .obj; `-` writes PLY to standard output.
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Save the map, for `tsdfuse mesh` and `tsdfuse render`; --output may then be missing.
    #[arg(long, value_name = "FILE")]
    pub(super) save_map: Option<PathBuf>,
    /// A picture of the whole result, .png.
    #[arg(long, value_name = "FILE")]
    pub(super) preview: Option<PathBuf>,
    #[arg(long, value_parser = PossibleValuesParser::new(Method::ALL.iter().map(|m| m.name())),
        help = format!("How scans are fused [default: {}, or depth for depth cameras]", Method::default().name()))]
    method: Option<String>,
    #[arg(long, value_name = "M",
        help = format!("Edge of a voxel, metres [default: {}, or {DEPTH_CAMERA_VOXEL_SIZE_M} for depth cameras]",
            MapConfig::default().voxel_size_m))]
    voxel_size: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Half width of the band around the surface, metres [default: {}, or {DEPTH_CAMERA_TRUNCATION_M} for depth cameras]",
            MapConfig::default().truncation_m))]
    truncation: Option<f64>,
    /// Which scans are fused, counted from 0, the last one excluded; every STEP-th of them [default: all].
    #[arg(long, value_name = "FROM..TO[:STEP]")]
    scans: Option<Selection>,
    /// Poses to use instead of the data set's own (KITTI or TUM text).
    #[arg(long, value_name = "FILE")]
    pub(super) poses: Option<PathBuf>,
    /// The sensor: one of several in the log, or the model of the only one (pandar64, hdl64e, vlp16, ...).
    #[arg(long, value_name = "NAME")]
    pub(super) sensor: Option<String>,
    #[arg(long, value_name = "M",
        help = format!("Nearer returns are left out, metres [default: the data set's, or {}]", RangeLimits::default().min_range_m))]
    min_range: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Farther returns are left out, metres [default: the sensor's, {DEPTH_CAMERA_MAX_RANGE_M} for depth cameras, or {}]",
            RangeLimits::default().max_range_m))]
    max_range: Option<f64>,
    /// Threads; their number does not change the result [default: one for each core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    #[arg(
        long,
        value_name = "W",
        help = format!("Voxels of less weight do not become surface [default: {}]", MeshConfig::default().min_weight)
    )]
    min_weight: Option<f64>,
    /// Write what was done, with the configuration, counts and times of each scan, as JSON.
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    /// Read settings from a TOML file.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set anything a --config file can set, for instance raycast.distance=projective.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Go on without scans that cannot be used; they are named, and the exit code is 3.
    #[arg(long)]
    pub(super) skip_bad: bool,
    /// Print the report on standard output.
    #[arg(long)]
    pub(super) json: bool,
}

impl Args {
    /// All settings but those that only the data can tell.
    pub(super) fn layers(&self) -> Result<Layers> {
        let mut layers = self
            .config
            .as_deref()
            .map(Layers::read)
            .transpose()?
            .unwrap_or_default();
        for setting in &self.set {
            layers.set_text(setting)?;
        }
        if let Some(method) = &self.method {
            layers.set("--method", "method", method.as_str())?;
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
                layers.set(flag, key, value)?;
            }
        }
        Ok(layers)
    }

    /// Finds out before the work, not after it, that its results could not be written.
    pub(super) fn check_outputs(&self) -> Result<()> {
        if let Some(mesh) = &self.output {
            output::check_mesh(mesh, self.json)?;
        }
        if let Some(preview) = &self.preview {
            tsdfuse_io::png::check(preview).map_err(Usage::new)?;
        }
        let files: Vec<_> = self.save_map.iter().chain(&self.report).chain(&self.preview).collect();
        let results: Vec<_> = self.output.iter().chain(files.iter().copied()).collect();
        if let Some(twice) = results
            .iter()
            .enumerate()
            .find_map(|(i, file)| results[..i].contains(file).then_some(file))
        {
            return Err(Usage::new(format_args!("{}: two results cannot be one file", twice.display())).into());
        }
        files.into_iter().try_for_each(|file| output::check_file(file))
    }

    pub(super) fn set_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().with_context(|| format!("--threads {threads}"))
    }

    /// The numbers of the scans to fuse.
    pub(super) fn indices(&self, scans: usize) -> Result<Vec<usize>> {
        let Some(Selection { from, to, step }) = self.scans else {
            return Ok((0..scans).collect());
        };
        if from >= scans {
            bail!(Usage::new(format_args!(
                "--scans begins at {from}, but there are only {scans} scans"
            )));
        }
        if let Some(to) = to.filter(|&to| to > scans) {
            note(format_args!("--scans ends at {to}, but there are only {scans} scans"));
        }
        let range = from..to.unwrap_or(scans).min(scans);
        Ok(range.step_by(step).collect())
    }
}

/// Every `step`-th scan of `from..to`.
#[derive(Clone, Debug, PartialEq)]
struct Selection {
    from: usize,
    to: Option<usize>,
    step: usize,
}

impl FromStr for Selection {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || "FROM..TO or FROM..TO:STEP is wanted, as in 0..80:2; FROM or TO may be left out".to_owned();
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| wanted());
        let (range, step) = text
            .split_once(':')
            .map_or((text, None), |(range, step)| (range, Some(step)));
        let (from, to) = range.split_once("..").ok_or_else(wanted)?;
        let selection = Self {
            from: if from.is_empty() { 0 } else { number(from)? },
            to: if to.is_empty() { None } else { Some(number(to)?) },
            step: step.map_or(Ok(1), number)?,
        };
        match selection {
            Self { step: 0, .. } => Err("a step is 1 or more".to_owned()),
            Self { from, to: Some(to), .. } if from >= to => Err("it selects no scan".to_owned()),
            selection => Ok(selection),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_selected_by_range_and_step() {
        let select = |text: &str| text.parse::<Selection>().map(|s| (s.from, s.to, s.step));
        assert_eq!(select("0..80"), Ok((0, Some(80), 1)));
        assert_eq!(select("5..80:3"), Ok((5, Some(80), 3)));
        assert_eq!(select("5.."), Ok((5, None, 1)));
        assert_eq!(select("..7:2"), Ok((0, Some(7), 2)));
        for bad in ["", "5", "a..b", "-1..3", "0..5:", "0..5:0", "5..5", "7..3", "0..5:x"] {
            assert!(select(bad).is_err(), "{bad}");
        }
    }
}
