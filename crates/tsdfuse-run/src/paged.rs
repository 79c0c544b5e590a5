//! A map of which only a part is in memory, and that outlives a crash.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use tsdfuse::glam::IVec3;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{Changes, Incremental, Mesh, MeshConfig, Nearby};
use tsdfuse::{Pose, Scan, SensorModel, VoxelMap};
use tsdfuse_io::map_file::{FusedPose, Reader};
use tsdfuse_store::{PagedError, PagedMap, StoreError};
use tsdfuse_view::Scene;

use crate::backend::{Backend, Failed, Integrators, Settled};
use crate::checkpoint::Checkpoint;
use crate::error::{Result, RunError};
use crate::event::{Event, Observer};
use crate::layers::Layers;
use crate::report::{MapReport, MeshReport, PagingReport, SavedMap};
use crate::setup::Setup;
use crate::surface;
use crate::view::See;

pub(crate) struct Paged {
    map: PagedMap,
    integrators: Integrators,
    config: MeshConfig,
    commits: usize,
    commit_seconds: f64,
    /// A store that only bounds memory is removed in the end.
    temporary: Option<PathBuf>,
}

impl Paged {
    /// Begins with an empty map and a new store; it may replace one that is there.
    pub(crate) fn begin(
        setup: &Setup,
        sensors: &[Option<SensorModel>],
        checkpoint: &Checkpoint,
        replaces: bool,
        observer: &mut dyn Observer,
    ) -> Result<Self> {
        let path = match &setup.store {
            Some(store) => store.clone(),
            None => {
                let store = temporary_store(&setup.temporary);
                remove_stale(&store, observer);
                store
            }
        };
        let map = VoxelMap::new(setup.config.map)?;
        let make = if replaces { PagedMap::replace } else { PagedMap::create };
        let map = make(&path, map, &checkpoint.bytes(), setup.memory_bytes)?;
        let mut paged = Self::resume(map, setup, sensors);
        paged.temporary = setup.store.is_none().then_some(path);
        Ok(paged)
    }

    /// Goes on with a store.
    pub(crate) fn resume(map: PagedMap, setup: &Setup, sensors: &[Option<SensorModel>]) -> Self {
        Self {
            map,
            integrators: Integrators::new(&setup.config, sensors),
            config: setup.config.mesh,
            commits: 0,
            commit_seconds: 0.0,
            temporary: None,
        }
    }

    /// Ends without a result: the store goes, too.
    pub(crate) fn remove(mut self) {
        self.temporary = Some(self.map.path().to_owned());
    }

    /// Tells the store the poses that it does not know yet; it knows the first ones.
    fn know(&mut self, poses: &[FusedPose]) {
        let known = self.map.poses().len();
        self.map.add_poses(poses.get(known..).unwrap_or_default());
    }

    /// Puts a saved map into the store; tells how many blocks it has.
    pub(crate) fn load(&mut self, reader: Reader<impl std::io::Read>) -> Result<usize> {
        self.map.set_integrations(reader.integrations());
        let (mut failed, mut blocks) = (None::<StoreError>, 0);
        reader.for_each_block(|index, block| {
            if failed.is_none() {
                failed = self.map.put_block(index, block).err();
                blocks += 1;
            }
            Ok(())
        })?;
        failed.map_or(Ok(blocks), |error| Err(error.into()))
    }
}

impl Drop for Paged {
    fn drop(&mut self) {
        if let Some(path) = &self.temporary {
            // It is of no use to anybody.
            let _ = fs::remove_file(path);
        }
    }
}

impl Backend for Paged {
    fn fuse(&mut self, sensor: usize, scan: &Scan) -> Result<Vec<Settled>, Failed> {
        let done = self
            .map
            .integrate(self.integrators.of(sensor), scan)
            .map_err(|error| match error {
                PagedError::Fuse(error) => Failed::of(error),
                PagedError::Store(error) => Failed::Run(error.into()),
            })?;
        Ok(vec![done.into()])
    }

    fn prefetch(&mut self, next: &[Pose]) -> Result<()> {
        Ok(next.iter().try_for_each(|pose| self.map.prefetch(pose.translation))?)
    }

    fn needs_sensor(&self) -> bool {
        self.integrators.needs_sensor()
    }

    fn finish(&mut self) -> Result<Vec<BlockIndex>> {
        Ok(Vec::new()) // methods that collect scans are refused
    }

    fn follow(&mut self, updated: &[BlockIndex], _: Option<&Nearby>, changes: &mut Changes) -> Result<()> {
        // What surrounds an updated block is within the scan's reach, so it is still in memory.
        let map = self.map.map_in_memory();
        let mut near: Vec<BlockIndex> = updated.iter().flat_map(|&block| around(block, 2)).collect();
        near.sort_unstable();
        near.dedup();
        near.retain(|&block| map.block(block).is_some());
        let mut surface = Incremental::new(&self.config);
        surface.note(&near);
        surface.changes(map, changes);
        let mut known: Vec<BlockIndex> = updated.iter().flat_map(|&block| around(block, 1)).collect();
        known.sort_unstable();
        changes.retain(|block| known.binary_search(&block).is_ok());
        Ok(())
    }

    fn mesh(&mut self, _: &MeshConfig) -> Result<Mesh> {
        Err(RunError::config(
            "the surface of a map that is not all in memory comes in parts: write it to a file",
        ))
    }

    fn whole_mesh(&mut self, config: &MeshConfig) -> Result<Mesh> {
        surface::gather(&mut self.map, config)
    }

    fn write_surface(
        &mut self,
        config: &MeshConfig,
        path: &Path,
        scene: &Scene,
        layers: &Layers,
    ) -> Result<MeshReport> {
        surface::write_in_parts_with(&mut self.map, config, path, scene, layers)
    }

    fn save(&mut self, path: &Path, poses: &[FusedPose]) -> Result<SavedMap> {
        self.know(poses);
        surface::save_in_parts(&mut self.map, path)
    }

    fn viewer(&mut self, _: f32, _: &mut dyn FnMut(See<'_>) -> Result<()>) -> Result<()> {
        Err(RunError::config("a picture needs the whole map in memory"))
    }

    fn map_around(&self) -> Option<&VoxelMap> {
        Some(self.map.map_in_memory())
    }

    fn report(&self) -> MapReport {
        MapReport::of_paged(&self.map)
    }

    fn commit(&mut self, checkpoint: &[u8], poses: &[FusedPose]) -> Result<bool> {
        let start = Instant::now();
        self.know(poses);
        self.map.commit(checkpoint)?;
        self.commits += 1;
        self.commit_seconds += start.elapsed().as_secs_f64();
        Ok(self.temporary.is_none())
    }

    fn paging(&self) -> Option<PagingReport> {
        Some(PagingReport {
            limit_bytes: self.map.limit_bytes(),
            most_bytes: self.map.most_bytes(),
            store_bytes: self.map.store_bytes(),
            commits: self.commits,
            paging_seconds: self.map.paging_secs(),
            commit_seconds: self.commit_seconds,
        })
    }

    fn over_limit(&mut self) -> Option<usize> {
        self.map.over_limit().map(|over| over.bytes)
    }
}

/// A block and those around it, this far.
fn around(BlockIndex(block): BlockIndex, far: i32) -> impl Iterator<Item = BlockIndex> {
    let edge = move || -far..=far;
    edge().flat_map(move |z| edge().flat_map(move |y| edge().map(move |x| BlockIndex(block + IVec3::new(x, y, z)))))
}

/// How a temporary store's name ends.
const ENDING: &str = ".store";

/// Where this process has its temporary store, beside a result or in a folder.
fn temporary_store(beside: &Path) -> PathBuf {
    let hidden = |name: &str| format!(".{name}.{}{ENDING}", std::process::id());
    if beside.is_dir() {
        return beside.join(hidden("tsdfuse"));
    }
    beside.with_file_name(hidden(&beside.file_name().unwrap_or_default().to_string_lossy()))
}

/// Removes what runs that were killed left in the same folder: temporary stores that no process has open.
fn remove_stale(store: &Path, observer: &mut dyn Observer) {
    let folder = store.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = fs::read_dir(folder.unwrap_or(Path::new(".")));
    for path in entries.into_iter().flatten().flatten().map(|entry| entry.path()) {
        if is_temporary_store(&path) && tsdfuse_store::remove_unused(&path) {
            observer.on(Event::Note(&format!(
                "{}: was left by a killed run; removed",
                path.display()
            )));
        }
    }
}

/// Whether a file is called `.NAME.PID.store`.
fn is_temporary_store(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let middle = name.strip_prefix('.').and_then(|name| name.strip_suffix(ENDING));
    let pid = middle.and_then(|middle| middle.rsplit_once('.'));
    pid.is_some_and(|(name, pid)| !name.is_empty() && pid.parse::<u32>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Silent;
    use tsdfuse::MapConfig;

    #[test]
    fn only_stores_of_killed_runs_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let map = || VoxelMap::new(MapConfig::default()).unwrap();
        let store = |name: &str| PagedMap::create(dir.path().join(name), map(), b"", Some(1 << 20)).unwrap();
        let others = [
            ".a.ply.8.store",
            "a.ply.7.store",
            ".a.store",
            ".a.ply.x.store",
            ".b.ply.9.store",
        ];
        let left = |names: &[&str]| names.iter().filter(|name| dir.path().join(name).exists()).count();
        drop(store(".a.ply.7.store"));
        let used = store(others[0]);
        others[1..4].iter().for_each(|name| drop(store(name)));
        fs::write(dir.path().join(others[4]), b"redb it is not").unwrap();
        let own = temporary_store(&dir.path().join("c.ply"));
        remove_stale(&own, &mut Silent);
        assert_eq!((left(&[".a.ply.7.store"]), left(&others)), (0, 5));
        drop(used);
        remove_stale(&own, &mut Silent);
        assert_eq!((left(&others[..1]), left(&others)), (0, 4));
        assert!(is_temporary_store(&own));
        assert!(is_temporary_store(&temporary_store(dir.path())));
    }
}
