//! What GPUs say in a build without the feature `gpu`.

use tsdfuse::mesh::{Mesh, MeshConfig};
use tsdfuse::render::RenderConfig;
use tsdfuse::{SensorModel, VoxelMap};

use crate::backend::Backend;
use crate::config::RunConfig;
use crate::error::{Result, RunError};
use crate::view::Look;

fn none() -> RunError {
    RunError::config("this build does not support GPUs (built without the feature gpu)")
}

pub(crate) fn open(
    _: Option<&str>,
    _: &VoxelMap,
    _: &RunConfig,
    _: &[Option<SensorModel>],
) -> Result<Box<dyn Backend>> {
    Err(none())
}

pub(crate) fn mesh(_: Option<&str>, _: &VoxelMap, _: &MeshConfig) -> Result<Mesh> {
    Err(none())
}

pub(crate) fn look<'a>(_: Option<&str>, _: &VoxelMap, _: &RenderConfig) -> Result<Look<'a>> {
    Err(none())
}
