//! The simulated street: the same scans on every machine.

use anyhow::{Context, Result};
use tempfile::TempDir;
use tsdfuse::MapConfig;
use tsdfuse_io::plain::Writer;
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

use crate::config::Layers;
use crate::progress;

/// Stands for the data set where none is named.
pub(super) const NAME: &str = "a simulated street, Pandar64";

const SCANS: usize = 20;
const SENSOR: &str = "pandar64";

/// Voxels of a long drive, whose map is to fit into memory.
const COARSE: MapConfig = MapConfig {
    voxel_size_m: 0.125,
    truncation_m: 0.5,
    max_weight: tsdfuse::map::MAX_WEIGHT,
};

/// A drive through the street.
pub(super) fn simulator(sensor: &str, scans: usize) -> Result<Simulator> {
    let scene = scene::by_name("street", 0).context("the street cannot be built")?;
    let sensor = tsdfuse::sensor::model(sensor).context("the sensor is not known")?;
    let path = path::default_for(&scene, scans);
    Ok(Simulator::new(scene, sensor, path, SimulatorConfig::default())?)
}

/// Writes the scans into a folder that is gone when it is dropped.
pub(super) fn write() -> Result<TempDir> {
    let simulator = simulator(SENSOR, SCANS)?;
    let folder = tempfile::tempdir().context("no folder for simulated scans can be made")?;
    let mut writer = Writer::create(folder.path())?;
    writer.write_sensor(simulator.sensor())?;
    let bar = progress::scans("simulating", SCANS);
    for scan in simulator.scans() {
        writer.write_scan(&scan)?;
        bar.inc(1);
    }
    writer.finish()?;
    Ok(folder)
}

/// Sets the voxels of a long drive, where none are set.
pub(super) fn coarse(layers: &mut Layers) -> Result<()> {
    for (key, value) in [
        ("voxel_size_m", COARSE.voxel_size_m),
        ("truncation_m", COARSE.truncation_m),
    ] {
        if !layers.has("map", key) {
            layers.set("--long-drive", &format!("map.{key}"), value)?;
        }
    }
    Ok(())
}
