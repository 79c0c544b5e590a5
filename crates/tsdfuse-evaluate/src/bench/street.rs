//! The simulated street: the same scans on every machine.

use tempfile::TempDir;
use tsdfuse_io::plain::Writer;
use tsdfuse_sim::{Simulator, SimulatorConfig, path, scene};

use crate::error::{Error, Result};
use crate::progress::{Progress, Watch};

/// Stands for the path of a log: the street is simulated then.
pub const STREET: &str = "a simulated street, Pandar64";

const SCANS: usize = 20;
const SENSOR: &str = "pandar64";

/// A drive through the street.
pub(crate) fn simulator(sensor: &str, scans: usize) -> Result<Simulator> {
    let unknown = |what: &str| Error::failed(format_args!("nothing is known of the {what}"));
    let scene = scene::by_name("street", 0).ok_or_else(|| unknown("street"))?;
    let sensor = tsdfuse::sensor::model(sensor).ok_or_else(|| unknown(sensor))?;
    let path = path::default_for(&scene, scans);
    Ok(Simulator::new(scene, sensor, path, SimulatorConfig::default())?)
}

/// Writes the scans into a folder that is gone when it is dropped.
pub(crate) fn write(watch: &mut Watch<'_>) -> Result<TempDir> {
    let simulator = simulator(SENSOR, SCANS)?;
    let folder = tempfile::tempdir().map_err(Error::at(&std::env::temp_dir()))?;
    let mut writer = Writer::create(folder.path())?;
    writer.write_sensor(simulator.sensor())?;
    watch(Progress::Begun {
        work: "simulating",
        steps: Some(SCANS),
    });
    for scan in simulator.scans() {
        writer.write_scan(&scan)?;
        watch(Progress::Step);
    }
    watch(Progress::Done);
    writer.finish()?;
    Ok(folder)
}
