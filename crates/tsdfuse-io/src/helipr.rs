//! HeLiPR: one sequence, `LiDAR/{Aeva,Avia,Ouster,Velodyne}/*.bin` with `LiDAR_GT/NAME_gt.txt`.
//!
//! Four scanners of different makers, each a sensor of its own with poses of its own in one world. Scans are named by their time in
//! nanoseconds; each point has its time, counted from there. Read is the Ouster, or those that `--sensor` names, together.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::files;
use crate::folder::{self, ScanFolder};
use crate::records;
use crate::scalar::Scalar;
use crate::source::{OpenOptions, Source};
use crate::together::Together;

type Reader = fn(&Path, &[u8]) -> Result<Cloud>;

/// The scanners, the default first, and how their files are read.
const SCANNERS: [(&str, Reader); 4] = [
    ("Ouster", ouster),
    ("Velodyne", velodyne),
    ("Avia", avia),
    ("Aeva", aeva),
];
/// Files of the Aeva after this time, nanoseconds, have intensities.
const AEVA_WITHOUT_INTENSITIES_NS: usize = 1_691_936_557_946_849_179;

/// Whether it is a sequence, or the folder of one of its scanners.
pub(crate) fn recognises(path: &Path) -> bool {
    place(path).is_some()
}

/// The sequence's folder, and the scanner if its own folder was named.
fn place(path: &Path) -> Option<(PathBuf, Option<&'static str>)> {
    let has = |root: &Path, name: &str| {
        files::list(&root.join("LiDAR").join(name), "bin").is_ok_and(|scans| !scans.is_empty())
    };
    let mut names = SCANNERS.iter().map(|(name, _)| *name);
    if names.clone().any(|name| has(path, name)) {
        return Some((path.to_owned(), None));
    }
    let root = path.join("../..");
    let name = names.find(|name| files::name(path) == *name && has(&root, name))?;
    Some((root, Some(name)))
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Together> {
    let (root, own) = place(path).unwrap_or((path.to_owned(), None));
    let there: Vec<_> = SCANNERS
        .into_iter()
        .filter(|(name, _)| root.join("LiDAR").join(name).is_dir())
        .collect();
    let is_asked = |name: &str| match (own, options.sensors.as_slice()) {
        (Some(own), _) => own == name,
        (None, []) => there.first().is_some_and(|(first, _)| *first == name),
        (None, names) => names.iter().any(|asked| asked == name),
    };
    if let Some(wrong) = options
        .sensors
        .iter()
        .find(|asked| !there.iter().any(|(name, _)| name == asked))
    {
        let names: Vec<_> = there.iter().map(|(name, _)| *name).collect();
        let reason = format!("there is no scanner {wrong:?}; there are {}", names.join(", "));
        return Err(Error::dataset(path, reason));
    }
    let mut logs: Vec<Arc<dyn Source>> = Vec::new();
    for (name, reader) in there.iter().filter(|(name, _)| is_asked(name)) {
        let scans = files::list(&root.join("LiDAR").join(name), "bin")?;
        let of_scanner = OpenOptions {
            sensors: Vec::new(),
            ..options.clone()
        };
        let poses = folder::poses(
            &root,
            &of_scanner,
            &root.join("LiDAR_GT").join(format!("{name}_gt.txt")),
        )?;
        let (scans, left_out) = folder::covered(&root, scans, poses.as_ref())?;
        let log = ScanFolder::new("HeLiPR", &root, &scans, poses, &of_scanner)?.with_reader(*reader);
        logs.push(Arc::new(log.called(name).without(left_out)));
    }
    Together::new(logs)
}

const XYZ: [(&str, Scalar); 3] = [("x", Scalar::F32), ("y", Scalar::F32), ("z", Scalar::F32)];

fn ouster(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let rest = [
        ("intensity", Scalar::F32),
        ("t", Scalar::U32),
        ("reflectivity", Scalar::U16),
        ("ring", Scalar::U16),
        ("ambient", Scalar::U16),
    ];
    records::parse(path, bytes, &[&XYZ[..], &rest].concat())
}

fn velodyne(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let rest = [("intensity", Scalar::F32), ("ring", Scalar::U16), ("time", Scalar::F32)];
    records::parse(path, bytes, &[&XYZ[..], &rest].concat())
}

/// Its lines are six beams that draw rosettes: no rings.
fn avia(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let rest = [
        ("reflectivity", Scalar::U8),
        ("tag", Scalar::U8),
        ("line number", Scalar::U8),
        ("offset_time", Scalar::U32),
    ];
    records::parse(path, bytes, &[&XYZ[..], &rest].concat())
}

fn aeva(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let rest = [
        ("reflectivity", Scalar::F32),
        ("velocity", Scalar::F32),
        ("time_offset", Scalar::I32),
        ("line number", Scalar::U8),
    ];
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let is_short = stem
        .parse()
        .is_ok_and(|time_ns: usize| time_ns <= AEVA_WITHOUT_INTENSITIES_NS);
    let intensity: &[_] = if is_short { &[] } else { &[("intensity", Scalar::F32)] };
    records::parse(path, bytes, &[&XYZ[..], &rest, intensity].concat())
}
