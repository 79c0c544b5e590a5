//! Calibration files beside a recording of packets.

use std::path::{Path, PathBuf};

use tsdfuse_packets::{Calibration, Decoder, Sensor};

use crate::error::{Error, Result};
use crate::files;

/// Larger files are no calibrations.
const MAX_BYTES: u64 = 4 << 20;
/// Of a folder with more such files, only the first ones are looked at.
const MAX_FILES: usize = 200;

/// The calibrations that lie beside a recording: JSON, CSV, YAML or XML in its folder, in `calibration/` there, or in
/// `calibration/` beside it.
#[derive(Debug, Default)]
pub(crate) struct Calibrations {
    stem: String,
    found: Vec<Found>,
    /// Files that are named as the recording is but cannot be read, and why.
    pub(crate) unreadable: Vec<String>,
}

#[derive(Debug)]
struct Found {
    path: PathBuf,
    calibration: Calibration,
    /// In the folder of the recording itself.
    is_beside: bool,
}

impl Calibrations {
    /// The one that is named, or else those beside the recording.
    ///
    /// # Errors
    /// If the one that is named cannot be read.
    pub(crate) fn given_or_beside(given: Option<&Path>, recording: &Path) -> Result<Self> {
        let Some(path) = given else {
            return Ok(Self::beside(recording));
        };
        let calibration = Calibration::parse(&files::read(path)?);
        Ok(Self {
            stem: stem(path),
            found: vec![Found {
                calibration: calibration.map_err(|reason| Error::format(path, reason.to_string()))?,
                path: path.to_owned(),
                is_beside: true,
            }],
            unreadable: Vec::new(),
        })
    }

    /// Looks for them.
    fn beside(recording: &Path) -> Self {
        let folder = if recording.is_dir() {
            recording
        } else {
            recording.parent().unwrap_or(Path::new(""))
        };
        let folder = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        };
        let stem = recording.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let mut all = Self {
            stem: stem.unwrap_or_default(),
            ..Self::default()
        };
        for (folder, is_beside) in [
            (folder.to_owned(), true),
            (folder.join("calibration"), true),
            (folder.join("../calibration"), false),
        ] {
            for name in files::names(&folder)
                .unwrap_or_default()
                .into_iter()
                .filter(|name| is_candidate(name))
                .take(MAX_FILES)
            {
                all.read(folder.join(&name), is_beside);
            }
        }
        all
    }

    fn read(&mut self, path: PathBuf, is_beside: bool) {
        let is_small =
            |path: &Path| std::fs::metadata(path).is_ok_and(|data| data.is_file() && data.len() <= MAX_BYTES);
        let Some(bytes) = is_small(&path).then(|| std::fs::read(&path).ok()).flatten() else {
            return;
        };
        match Calibration::parse(&bytes) {
            Ok(calibration) => self.found.push(Found {
                path,
                calibration,
                is_beside,
            }),
            Err(reason) if stem(&path) == self.stem => self.unreadable.push(format!("{}: {reason}", path.display())),
            Err(_) => {}
        }
    }

    /// The calibration for a sensor that sends such packets, and its file: named as the recording or as the sensor, or the only
    /// one for it in the recording's folder. Of Ouster's metadata, those that fit the packet, the more alike in name first.
    pub(crate) fn of(&self, sensor: Sensor, payload: &[u8]) -> Option<(&Path, &Calibration)> {
        let fits = |found: &&Found| match &found.calibration {
            Calibration::Ouster(metadata) => sensor == Sensor::Ouster && metadata.fits(payload),
            other => sensor != Sensor::Ouster && Decoder::new(sensor, other.clone()).is_ok(),
        };
        let fitting: Vec<&Found> = self.found.iter().filter(fits).collect();
        let alike = |found: &Found| {
            let (a, b) = (stem(&found.path), &self.stem);
            a.bytes().zip(b.bytes()).take_while(|(a, b)| a == b).count()
        };
        let is_named = |found: &&&Found| {
            let name = stem(&found.path);
            name == self.stem || Sensor::named(&name) == Some(sensor)
        };
        let beside = || fitting.iter().filter(|found| found.is_beside);
        let chosen = if sensor == Sensor::Ouster {
            beside().max_by_key(|found| alike(found))
        } else {
            let only = || Some(beside().next()?).filter(|_| beside().count() == 1);
            fitting.iter().find(is_named).or_else(only)
        };
        chosen.map(|found| (found.path.as_path(), &found.calibration))
    }
}

fn stem(path: &Path) -> String {
    path.file_stem()
        .map(|stem| stem.to_string_lossy().into_owned())
        .unwrap_or_default()
}

fn is_candidate(name: &str) -> bool {
    let extension = Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["json", "csv", "yaml", "yml", "xml"].contains(&extension.to_ascii_lowercase().as_str())
}
