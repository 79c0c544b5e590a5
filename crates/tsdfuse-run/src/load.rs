//! A saved map that is continued as if there had been no break.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use tsdfuse::fuse::Method;
use tsdfuse::map::MapError;
use tsdfuse::{MapConfig, SensorModel, VoxelMap};
use tsdfuse_io::map_file::{FusedPose, Reader};

use crate::config::RunConfig;
use crate::error::{Result, RunError};
use crate::event::{Event, Observer};
use crate::paged::Paged;
use crate::report::LoadedMap;

/// A saved map whose header was read.
pub(crate) struct Loading {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
}

impl Loading {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            reader: Reader::open(path)?,
        })
    }

    /// The poses of the scans that the map was made of, as far as it tells them.
    pub(crate) fn take_poses(&mut self) -> Vec<FusedPose> {
        self.reader.take_poses()
    }

    /// The configuration that the map was made with.
    pub(crate) fn config(&self) -> &MapConfig {
        self.reader.config()
    }

    /// Refuses what cannot continue this map, and tells what may differ from a run without a break.
    pub(crate) fn check(
        &self,
        config: &RunConfig,
        sensors: &[Option<SensorModel>],
        observer: &mut dyn Observer,
    ) -> Result<()> {
        let path = self.path.display();
        if let Err(MapError::Differ { name, a, b }) = self.reader.config().check_same(&config.map) {
            let told = format!("{path}: the map has {name} = {a}, but the settings say {b}");
            return Err(RunError::config(format_args!(
                "{told} (`tsdfuse map resample` makes other voxels)"
            )));
        }
        if config.method == Method::Patch && config.patch.carve && !self.reader.tells_integrations() {
            observer.on(Event::Note(&format!(
                "{path}: version 1 of the format does not record the number of scans; erasing will differ from that of an uninterrupted run"
            )));
        }
        let method = config.method.build(&config.methods(), None);
        if method.needs_sensor() && sensors.iter().any(Option::is_none) {
            observer.on(Event::Note(&format!(
                "the sensor is guessed from these scans, not from those in {path}; set --sensor to be sure it is the same"
            )));
        }
        Ok(())
    }

    fn loaded(&self, blocks: usize) -> LoadedMap {
        LoadedMap {
            path: self.path.clone(),
            integrations: self.reader.tells_integrations().then(|| self.reader.integrations()),
            blocks,
        }
    }

    /// Reads the map into memory.
    pub(crate) fn read(self) -> Result<(VoxelMap, LoadedMap)> {
        let mut loaded = self.loaded(0);
        let map = self.reader.map()?;
        loaded.blocks = map.block_count();
        Ok((map, loaded))
    }

    /// Reads the map into a store.
    pub(crate) fn read_into(self, paged: &mut Paged) -> Result<LoadedMap> {
        let mut loaded = self.loaded(0);
        loaded.blocks = paged.load(self.reader)?;
        Ok(loaded)
    }
}
