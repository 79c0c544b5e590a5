//! `--load-map`: a saved map that is continued as if there had been no break.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use anyhow::Result;
use serde::Serialize;
use tsdfuse::VoxelMap;
use tsdfuse::fuse::{Method, RoldaoForm};
use tsdfuse::map::MapError;
use tsdfuse_io::map_file::Reader;

use super::paging::Paging;
use crate::config::{Layers, RunConfig};
use crate::exit::Usage;
use crate::progress::note;

/// A saved map whose header was read.
pub(super) struct Loading {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
}

/// The map that was continued.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct LoadedMap {
    pub(crate) path: PathBuf,
    /// Scans (or images made of them) that it was made of, where the file tells.
    pub(crate) integrations: Option<u32>,
    pub(crate) blocks: usize,
}

impl Loading {
    pub(super) fn open(path: &Path) -> Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            reader: Reader::open(path)?,
        })
    }

    /// Settings that are the map's unless they are set.
    pub(super) fn suggest(&self, layers: &mut Layers) -> Result<()> {
        let config = self.reader.config();
        for (key, value) in [
            ("voxel_size_m", config.voxel_size_m),
            ("truncation_m", config.truncation_m),
            ("max_weight", config.max_weight.into()),
        ] {
            if !layers.has("map", key) {
                layers.set("--load-map", &format!("map.{key}"), value)?;
            }
        }
        Ok(())
    }

    /// Refuses what cannot continue this map, and tells what may differ from a run without a break.
    pub(super) fn check(&self, config: &RunConfig, knows_sensor: bool) -> Result<()> {
        let path = self.path.display();
        let same = self.reader.config().check_same(&config.map);
        if let Err(MapError::Differ { name, a, b }) = same {
            let told = format!("{path}: the map has {name} = {a}, but the settings say {b}");
            return Err(Usage::new(format_args!("{told} (`tsdfuse map resample` makes other voxels)")).into());
        }
        let method = config.method;
        if method == Method::Roldao && config.roldao.form == RoldaoForm::Batch {
            return Err(Usage::new(format_args!(
                "{path}: roldao.form = batch fits planes to all scans at once, and a saved map no longer holds them"
            ))
            .into());
        }
        if method == Method::Patch && config.patch.carve && !self.reader.tells_integrations() {
            note(format_args!(
                "{path}: its format, version 1, does not tell how many scans it holds; rays erase in other turns than without a break"
            ));
        }
        if !knows_sensor && config.wants_sensor() {
            note(format_args!(
                "the sensor is guessed from the first of these scans, not of those in {path}; --sensor makes sure it is the same"
            ));
        }
        Ok(())
    }

    /// Reads the map, into a store if there is one.
    pub(super) fn read(self, map: &mut VoxelMap, paging: Option<&mut Paging>) -> Result<LoadedMap> {
        let integrations = self.reader.tells_integrations().then(|| self.reader.integrations());
        let blocks = match paging {
            None => {
                *map = self.reader.map()?;
                map.block_count()
            }
            Some(paging) => paging.load(map, self.reader)?,
        };
        Ok(LoadedMap {
            path: self.path,
            integrations,
            blocks,
        })
    }
}
