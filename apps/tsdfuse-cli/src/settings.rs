//! What to fuse, and with what: the arguments that `fuse`, `evaluate` and `bench` share.

use std::ffi::OsString;
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use clap::builder::RangedI64ValueParser;
use tsdfuse::MapConfig;
use tsdfuse::mesh::MeshConfig;
use tsdfuse::scan::RangeLimits;
use tsdfuse_eval::held_out::is_held_out;
use tsdfuse_io::{Dataset, OpenOptions};

use crate::config::{DEPTH_CAMERA_MAX_RANGE_M, DEPTH_CAMERA_TRUNCATION_M, DEPTH_CAMERA_VOXEL_SIZE_M, Layers};
use crate::exit::Usage;
use crate::progress::note;

/// The data set and its settings.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Settings {
    /// The data set; its format (PandaSet, KITTI, a plain folder, RGB-D, ...) is recognised.
    pub(crate) dataset: PathBuf,
    #[arg(long, value_name = "M",
        help = format!("Edge of a voxel, metres [default: {}, or {DEPTH_CAMERA_VOXEL_SIZE_M} for depth cameras]",
            MapConfig::default().voxel_size_m))]
    pub(crate) voxel_size: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Half width of the band around the surface, metres [default: {}, or {DEPTH_CAMERA_TRUNCATION_M} for depth cameras]",
            MapConfig::default().truncation_m))]
    pub(crate) truncation: Option<f64>,
    /// Which scans are fused, counted from 0, the last one excluded; every STEP-th of them [default: all].
    #[arg(long, value_name = "FROM..TO[:STEP]")]
    pub(crate) scans: Option<Selection>,
    /// Poses to use instead of the data set's own (KITTI or TUM text).
    #[arg(long, value_name = "FILE")]
    pub(crate) poses: Option<PathBuf>,
    /// The sensor: one of several in the log, or the model of the only one (pandar64, hdl64e, vlp16, ...).
    #[arg(long, value_name = "NAME")]
    pub(crate) sensor: Option<String>,
    #[arg(long, value_name = "M",
        help = format!("Nearer returns are left out, metres [default: the data set's, or {}]", RangeLimits::default().min_range_m))]
    pub(crate) min_range: Option<f64>,
    #[arg(long, value_name = "M",
        help = format!("Farther returns are left out, metres [default: the sensor's, {DEPTH_CAMERA_MAX_RANGE_M} for depth cameras, or {}]",
            RangeLimits::default().max_range_m))]
    pub(crate) max_range: Option<f64>,
    /// Threads; their number does not change the result [default: one for each core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
    #[arg(
        long,
        value_name = "W",
        help = format!("Voxels of less weight do not become surface [default: {}]", MeshConfig::default().min_weight)
    )]
    pub(crate) min_weight: Option<f64>,
    /// Read settings from a TOML file.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Set anything a --config file can set, for instance raycast.distance=projective.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Go on without scans that cannot be used; they are named, and the exit code is 3.
    #[arg(long)]
    pub(crate) skip_bad: bool,
}

impl Settings {
    /// All settings but those that only the data can tell.
    pub(crate) fn layers(&self, method: Option<&str>) -> Result<Layers> {
        let mut layers = self
            .config
            .as_deref()
            .map(Layers::read)
            .transpose()?
            .unwrap_or_default();
        for setting in &self.set {
            layers.set_text(setting)?;
        }
        if let Some(method) = method {
            layers.set("--method", "method", method)?;
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

    /// Opens the data set and tells what is odd about it.
    pub(crate) fn open(&self) -> Result<Dataset> {
        let dataset = tsdfuse_io::open_with(&self.dataset, &self.open_options())?;
        dataset.notes().iter().for_each(note);
        Ok(dataset)
    }

    /// How the data set is opened.
    pub(crate) fn open_options(&self) -> OpenOptions {
        OpenOptions {
            poses: self.poses.clone(),
            sensor: self.sensor.clone(),
        }
    }

    /// The arguments again, for a run of `tsdfuse fuse` on the same data.
    pub(crate) fn arguments(&self) -> Vec<OsString> {
        fn text(value: Option<impl ToString>) -> Option<OsString> {
            value.map(|v| v.to_string().into())
        }
        let path = |path: &Option<PathBuf>| path.clone().map(PathBuf::into_os_string);
        let flags = [
            ("--config", path(&self.config)),
            ("--voxel-size", text(self.voxel_size)),
            ("--truncation", text(self.truncation)),
            ("--scans", text(self.scans.as_ref())),
            ("--poses", path(&self.poses)),
            ("--sensor", text(self.sensor.as_ref())),
            ("--min-range", text(self.min_range)),
            ("--max-range", text(self.max_range)),
            ("--threads", text(self.threads)),
            ("--min-weight", text(self.min_weight)),
        ];
        let flags = flags
            .into_iter()
            .filter_map(|(flag, value)| Some([flag.into(), value?]));
        let set = self.set.iter().map(|setting| ["--set".into(), setting.into()]);
        let mut arguments: Vec<OsString> = flags.chain(set).flatten().collect();
        arguments.extend(self.skip_bad.then(|| "--skip-bad".into()));
        arguments
    }

    pub(crate) fn set_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().with_context(|| format!("--threads {threads}"))
    }

    /// The numbers of the scans to fuse.
    pub(crate) fn indices(&self, scans: usize) -> Result<Vec<usize>> {
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

/// What `--hold-out` may be.
pub(crate) fn hold_out_range() -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(2..)
}

/// The scans that are fused and those that are held out, where `every` says how many.
pub(crate) fn split(indices: &[usize], every: Option<u32>) -> Result<(Vec<usize>, Vec<usize>)> {
    let Some(every) = every else {
        return Ok((indices.to_vec(), Vec::new()));
    };
    let is_held_out = |position| is_held_out(position, every as usize);
    let of = |held_out| {
        let kept = (0..)
            .zip(indices)
            .filter(|(position, _)| is_held_out(*position) == held_out);
        kept.map(|(_, index)| *index).collect::<Vec<_>>()
    };
    let (fused, held_out) = (of(false), of(true));
    if held_out.is_empty() || fused.is_empty() {
        let scans = indices.len();
        bail!(Usage::new(format_args!(
            "--hold-out {every}: {scans} scans are too few to hold out the middle one of each {every}"
        )));
    }
    Ok((fused, held_out))
}

/// Every `step`-th scan of `from..to`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Selection {
    from: usize,
    to: Option<usize>,
    step: usize,
}

impl Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let to = self.to.map_or(String::new(), |to| to.to_string());
        write!(f, "{}..{to}:{}", self.from, self.step)
    }
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

    #[test]
    fn a_selection_reads_back_as_it_was() {
        for text in ["0..80:1", "5..80:3", "5..:2"] {
            assert_eq!(text.parse::<Selection>().unwrap().to_string(), text);
        }
    }

    /// What is forwarded to another run is understood there as it was here.
    #[test]
    fn settings_read_back_as_they_were() {
        #[derive(Debug, clap::Parser)]
        struct Line {
            #[command(flatten)]
            settings: Settings,
        }
        let line = "tsdfuse log --config a.toml --voxel-size 0.1 --truncation 0.3 --scans 3..9:2 --poses p.txt --sensor vlp16 \
                    --min-range 1 --max-range 50 --threads 2 --min-weight 0.5 --set method=normals --set map.max_weight=9 --skip-bad";
        let read = <Line as clap::Parser>::try_parse_from(line.split_whitespace())
            .unwrap()
            .settings;
        let start = ["tsdfuse".into(), "log".into()];
        let again = <Line as clap::Parser>::try_parse_from(start.into_iter().chain(read.arguments())).unwrap();
        assert_eq!(format!("{:?}", again.settings), format!("{read:?}"));
        assert_eq!(read.arguments().len(), 25);
    }

    #[test]
    fn every_scan_is_fused_or_held_out() {
        let all: Vec<usize> = (10..35).collect();
        assert_eq!(split(&all, None).unwrap(), (all.clone(), vec![]));
        let (mut fused, held_out) = split(&all, Some(10)).unwrap();
        assert_eq!(held_out, [15, 25]);
        fused.extend(held_out);
        fused.sort_unstable();
        assert_eq!(fused, all);
        let told = split(&all[..3], Some(10)).unwrap_err();
        assert!(
            told.is::<Usage>() && told.to_string().contains("3 scans are too few"),
            "{told}"
        );
        assert_eq!(split(&all[..2], Some(2)).unwrap(), (vec![10], vec![11]));
    }
}
