//! What `--device gpu` says in a build without the feature `gpu`.

use anyhow::{Error, Result, anyhow};
use tsdfuse::mesh::MeshConfig;
use tsdfuse::render::RenderConfig;
use tsdfuse::{Mesh, SensorModel, VoxelMap};

use super::{OnDevice, See};
use crate::bench::Args;
use crate::config::RunConfig;
use crate::exit::Outcome;

fn none() -> Error {
    anyhow!("this build has no part for GPUs: it was made without the feature gpu")
}

pub(super) fn open(_: Option<&str>, _: &VoxelMap, _: &RunConfig, _: Option<&SensorModel>) -> Result<Box<dyn OnDevice>> {
    Err(none())
}

pub(super) fn mesh(_: Option<&str>, _: &VoxelMap, _: &MeshConfig) -> Result<Mesh> {
    Err(none())
}

pub(super) fn viewer<'a>(_: Option<&str>, _: &VoxelMap, _: &RenderConfig) -> Result<See<'a>> {
    Err(none())
}

pub(crate) fn run(_: &Args, _: Option<&str>) -> Result<Outcome> {
    Err(none())
}

pub(crate) fn is_full(_: &Error) -> bool {
    false
}
