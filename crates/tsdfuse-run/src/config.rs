//! All settings that determine the result of a run, apart from the data.

use serde::{Deserialize, Serialize};
use tsdfuse::MapConfig;
use tsdfuse::fuse::{CaminalConfig, FuseConfig, KuehnerConfig, Method, PatchConfig, RaycastConfig, RoldaoConfig};
use tsdfuse::mesh::MeshConfig;
use tsdfuse::normals::NormalsConfig;
use tsdfuse::scan::RangeLimits;
use tsdfuse::sensor::SensorCorrection;
use tsdfuse::surfel::SurfelConfig;
use tsdfuse_io::Log;
use tsdfuse_loops::LoopConfig;
use tsdfuse_odometry::OdometryConfig;

use crate::error::RunError;

/// All settings that determine the result of a run, apart from the data. Its default is for rotating LiDARs; [`Self::for_log`] is
/// what suits a log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunConfig {
    /// The fusion method.
    pub method: Method,
    /// The voxels.
    pub map: MapConfig,
    /// Which ranges are measurements.
    pub range: RangeLimits,
    /// The sensor's known errors, which are taken back as scans are read ([`tsdfuse_io::Sensor::correction`]).
    pub sensor: SensorCorrection,
    /// Options of the method `raycast`.
    pub raycast: RaycastConfig,
    /// Options of the method `normals`.
    pub normals: NormalsConfig,
    /// Options of the method `surfel`.
    pub surfel: SurfelConfig,
    /// Options of the method `kuehner`.
    pub kuehner: KuehnerConfig,
    /// Options of the method `caminal`.
    pub caminal: CaminalConfig,
    /// Options of the method `roldao`.
    pub roldao: RoldaoConfig,
    /// Options of the method `patch`.
    pub patch: PatchConfig,
    /// What becomes surface.
    pub mesh: MeshConfig,
    /// What becomes of returns of things that move.
    pub moving: MovingSettings,
    /// Options of the odometry, where it finds the poses.
    pub odometry: OdometryConfig,
    /// Options of loop closure.
    pub loops: LoopConfig,
}

/// What becomes of returns of things that move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MovingSettings {
    /// Whether they are left out ([`tsdfuse_plan::Moving`]); else they are fused as all others, and methods that erase take them away
    /// later. `None`: with the method `patch`, which erases what was fused of them before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leave_out: Option<bool>,
}

impl RunConfig {
    /// The defaults for a log: what it suggests of method, voxels and ranges, and the defaults of all else.
    pub fn for_log(log: &Log) -> Self {
        let suggested = log.suggested();
        Self {
            method: suggested.method,
            map: suggested.map,
            range: suggested.range,
            sensor: log
                .sensors()
                .first()
                .map_or_else(Default::default, |sensor| sensor.correction.clone()),
            ..Self::default()
        }
    }

    /// Whether returns of things that move are left out.
    pub fn leaves_out_moving(&self) -> bool {
        self.moving.leave_out.unwrap_or(self.method == Method::Patch)
    }

    /// The options of all methods.
    pub fn methods(&self) -> FuseConfig {
        FuseConfig {
            raycast: self.raycast,
            normals: self.normals,
            surfel: self.surfel,
            kuehner: self.kuehner,
            caminal: self.caminal,
            roldao: self.roldao,
            patch: self.patch,
        }
    }

    /// Checks all options.
    ///
    /// # Errors
    /// [`RunError::Config`] names the option and what is possible.
    pub fn validate(&self) -> Result<(), RunError> {
        self.map.validate().map_err(RunError::config)?;
        self.methods().validate().map_err(RunError::config)?;
        self.range.validate().map_err(RunError::config)?;
        self.mesh.validate().map_err(RunError::config)
    }
}
