//! Whether a scan takes longer as the map grows: an endless street, and the times of its scans.
//!
//! The street is driven through once. Then it comes again, moved along x by whole regions of the map. So each pass makes
//! new blocks, but does exactly the same work: what differs between passes is the size of the map.

use std::path::PathBuf;

use serde::Serialize;
use tsdfuse::MapConfig;
use tsdfuse_io::Log;
use tsdfuse_run::report::{MapReport, MeshReport, PagingReport, ScanReport};
use tsdfuse_run::{Machine, RunConfig, RunError, Session, Settings, Setup, peak_memory_bytes};

use super::drive::{Drive, PASS, Street};
use crate::error::{Error, Result};
use crate::form::Form;
use crate::progress::{Runs, Watch};
use crate::results::scan_secs;

/// Voxels of a long drive, whose map is to fit into memory.
const COARSE: MapConfig = MapConfig {
    voxel_size_m: 0.125,
    truncation_m: 0.5,
    max_weight: tsdfuse::map::MAX_WEIGHT,
};

/// A drive on and on through a simulated street.
#[derive(Clone, Debug)]
pub struct LongDrive {
    /// How many scans of a VLP-16.
    pub scans: usize,
    /// The method; `None`: that of the settings.
    pub form: Option<Form>,
    /// What is set; voxels are of 12.5 cm, if nothing is said of them.
    pub settings: Settings,
    /// The most memory for blocks of the map. If it is limited, the surface of the whole drive is extracted in the end.
    pub memory_bytes: Option<usize>,
    /// Where the temporary files go: the store and the mesh, if the memory is limited.
    pub folder: PathBuf,
    /// The arguments of the program, for the results.
    pub command_line: Vec<String>,
}

/// How long scans took.
#[derive(Clone, Debug, Serialize)]
pub struct LongDriveResults {
    /// The version of this crate.
    pub version: &'static str,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// This machine.
    pub machine: Machine,
    /// With what was fused.
    pub config: RunConfig,
    /// Each drive through the street.
    pub passes: Vec<Pass>,
    /// The whole map, if the memory was limited.
    pub stored: Option<Stored>,
}

/// The whole map at the end of a drive with limited memory.
#[derive(Clone, Debug, Serialize)]
pub struct Stored {
    /// The length of the drive.
    pub length_km: f64,
    /// The map.
    pub map: MapReport,
    /// What was done to keep it out of memory.
    pub paging: Option<PagingReport>,
    /// Its surface.
    pub mesh: MeshReport,
    /// The most memory that the process held, where the system tells.
    pub peak_memory_bytes: Option<u64>,
}

/// A drive through the street.
#[derive(Clone, Debug, Serialize)]
pub struct Pass {
    /// Its first scan.
    pub from: usize,
    /// `prepare + fuse` of each scan.
    pub scan_secs: Vec<f64>,
    /// Points that were fused.
    pub fused: u64,
    /// Blocks that were made or updated, summed over the scans.
    pub updated_blocks: usize,
    /// Blocks of the map after it.
    pub blocks: usize,
    /// Memory of those that are in memory.
    pub map_bytes: usize,
}

impl LongDrive {
    /// A drive with the default method, all in memory.
    pub fn of(scans: usize) -> Self {
        Self {
            scans,
            form: None,
            settings: Settings::default(),
            memory_bytes: None,
            folder: std::env::temp_dir(),
            command_line: Vec::new(),
        }
    }

    /// Drives.
    ///
    /// # Errors
    /// [`Error::Config`] for options that do not fit together. If the passes are not alike.
    pub fn run(&self, watch: &mut Watch<'_>) -> Result<LongDriveResults> {
        let mut settings = match &self.form {
            Some(form) => form.over(&self.settings)?,
            None => self.settings.clone(),
        };
        settings.set_missing("--long-drive", &COARSE)?;
        let street = Street::new()?;
        // What the log suggests does not depend on the voxels, but the drive does.
        let config = settings.resolve(&Log::new(Drive::new(&street, 1, COARSE.voxel_size_m)))?;
        let drive = Drive::new(&street, self.scans, config.map.voxel_size_m);
        let length_km = drive.length_m() / 1e3;
        let log = Log::new(drive);
        let folder = tempfile::Builder::new()
            .prefix(".tsdfuse-drive-")
            .tempdir_in(&self.folder);
        let folder = folder.map_err(Error::at(&self.folder))?;
        let setup = Setup {
            config: config.clone(),
            memory_bytes: self.memory_bytes,
            temporary: folder.path().to_owned(),
            ..Setup::default()
        };
        let observer = &mut Runs(watch);
        let mut session = Session::begin(&log, setup, observer)?;
        let mut passes: Vec<Pass> = Vec::new();
        for from in (0..self.scans).step_by(PASS) {
            for _ in from..self.scans.min(from + PASS) {
                session.step(observer)?;
            }
            if let Some(reason) = session.full() {
                return Err(RunError::Full(reason.to_owned()).into());
            }
            let map = session.map_report();
            let pass = Pass::of(from, &session.scans()[from..], map.blocks, map.bytes);
            pass.check(passes.first().unwrap_or(&pass))?;
            passes.push(pass);
        }
        session.finish(observer)?;
        let stored = self.memory_bytes.map(|_| {
            let mesh = session.write_surface(&folder.path().join("drive.ply"))?;
            Ok::<_, Error>(Stored {
                length_km,
                map: session.map_report(),
                paging: session.paging(),
                mesh,
                peak_memory_bytes: peak_memory_bytes(),
            })
        });
        Ok(LongDriveResults {
            version: env!("CARGO_PKG_VERSION"),
            command_line: self.command_line.clone(),
            machine: Machine::here(rayon::current_num_threads()),
            config,
            passes,
            stored: stored.transpose()?,
        })
    }
}

impl Pass {
    fn of(from: usize, scans: &[ScanReport], blocks: usize, map_bytes: usize) -> Self {
        Self {
            from,
            scan_secs: scans.iter().map(scan_secs).collect(),
            fused: scans.iter().map(|scan| scan.sums.fused).sum(),
            updated_blocks: scans.iter().map(|scan| scan.updated_blocks).sum(),
            blocks,
            map_bytes,
        }
    }

    /// A whole pass does what the first one does. (Blocks that `patch` knows take other turns in it, so a few may differ.)
    fn check(&self, first: &Self) -> Result<()> {
        let work = |pass: &Self| (pass.fused, pass.updated_blocks);
        if self.fused == 0 {
            let told = format!("no return could be fused from scan {} on", self.from);
            return Err(Error::Failed(told));
        }
        let is_alike = self.fused == first.fused
            && self.updated_blocks.abs_diff(first.updated_blocks) <= first.updated_blocks / 1000;
        if self.is_whole() && !is_alike {
            return Err(Error::failed(format_args!(
                "passes differ: {:?} returns and blocks in the first, {:?} from scan {} on",
                work(first),
                work(self),
                self.from
            )));
        }
        Ok(())
    }

    /// Whether it is no part of one.
    pub(crate) fn is_whole(&self) -> bool {
        self.scan_secs.len() == PASS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pass(secs: f64, fused: u64, updated_blocks: usize) -> Pass {
        Pass {
            from: 0,
            scan_secs: (0..PASS).map(|scan| secs + scan as f64).collect(),
            fused,
            updated_blocks,
            blocks: 9,
            map_bytes: 9,
        }
    }

    #[test]
    fn a_pass_that_does_other_work_is_refused() {
        let first = pass(1.0, 7, 3);
        assert!(pass(2.0, 7, 3).check(&first).is_ok());
        for other in [pass(1.0, 8, 3), pass(1.0, 7, 4)] {
            let told = other.check(&first).unwrap_err().to_string();
            assert!(
                told.starts_with("passes differ: (7, 3) returns and blocks in the first"),
                "{told}"
            );
        }
        let told = pass(1.0, 0, 3).check(&first).unwrap_err().to_string();
        assert_eq!(told, "no return could be fused from scan 0 on");
        // The last pass may be a part of one.
        let mut part = pass(1.0, 6, 2);
        part.scan_secs.pop();
        assert!(part.check(&first).is_ok());
    }
}
