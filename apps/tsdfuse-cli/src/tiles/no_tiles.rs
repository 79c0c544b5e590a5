//! What `-o NAME/tileset.json` says in a build without the feature `tiles`.

use std::path::Path;

use anyhow::Result;
use tsdfuse_store::Surface;

use crate::exit::Usage;
use crate::report::MeshReport;

pub(crate) fn check(path: &Path) -> Result<()> {
    let told = "this build writes no 3D Tiles: it was made without the feature tiles";
    Err(Usage::new(format_args!("{}: {told}", path.display())).into())
}

pub(crate) fn write(path: &Path, _: &mut Surface<'_>) -> Result<MeshReport> {
    check(path)?;
    Ok(MeshReport::default())
}
