//! What `-o NAME.zarr` says in a build without the feature `zarr`.

use std::path::Path;

use anyhow::Result;
use tsdfuse::VoxelMap;
use tsdfuse_store::Pager;

use crate::exit::Usage;

pub(super) fn check(path: &Path) -> Result<()> {
    let told = "this build writes no Zarr arrays: it was made without the feature zarr";
    Err(Usage::new(format_args!("{}: {told}", path.display())).into())
}

pub(super) fn of_map(path: &Path, _: &VoxelMap) -> Result<()> {
    check(path)
}

pub(super) fn of_store(path: &Path, _: &mut VoxelMap, _: &mut Pager) -> Result<()> {
    check(path)
}
