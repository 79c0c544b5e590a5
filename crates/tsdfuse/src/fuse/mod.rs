//! Fusing scans into the map: one trait, one file per method, one engine underneath.
//!
//! A method decides, for each return of a scan, which voxels it touches, with what signed distance and what weight. All
//! else is shared: `placed` puts returns into the world (undoing motion), `cylinder` and `pierced` walk the voxels
//! about or on a line, and the two engines, `lines` and `gather`, find blocks, write updates and spread the work over threads.

mod beams;
mod caminal;
mod carve;
mod centers;
mod cylinder;
mod cylindrical;
mod depth;
mod gather;
mod kuehner;
mod lines;
mod normals;
mod patch;
mod pierced;
mod placed;
mod raycast;
mod roldao;
mod surfel;
#[doc(hidden)]
pub mod twin;

use serde::{Deserialize, Serialize};

pub use beams::{Beams, rings_of};
pub use caminal::{Caminal, CaminalConfig};
pub use cylindrical::Cylindrical;
pub use depth::Depth;
pub use kuehner::Kuehner;
pub use normals::Normals;
pub use patch::{Patch, PatchConfig};
pub use raycast::{Distance, Raycast, RaycastConfig};
pub use roldao::{Roldao, RoldaoConfig, RoldaoForm};
pub use surfel::Surfels;

use crate::{
    index::BlockIndex, map::VoxelMap, normals::NormalsConfig, scan::Scan, scan::ScanError, sensor::SensorModel,
    surfel::SurfelConfig,
};

/// The methods, by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// [`Raycast`].
    Raycast,
    /// [`Normals`].
    Normals,
    /// [`Surfels`].
    Surfel,
    /// [`Cylindrical`].
    Cylindrical,
    /// [`Kuehner`].
    Kuehner,
    /// [`Depth`].
    Depth,
    /// [`Caminal`].
    Caminal,
    /// [`Roldao`].
    Roldao,
    /// [`Patch`]: our own.
    #[default]
    Patch,
}

/// The options of all methods.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseConfig {
    /// Options of [`Raycast`].
    pub raycast: RaycastConfig,
    /// Options of [`Normals`].
    pub normals: NormalsConfig,
    /// Options of [`Surfels`].
    pub surfel: SurfelConfig,
    /// Options of [`Caminal`].
    pub caminal: CaminalConfig,
    /// Options of [`Roldao`].
    pub roldao: RoldaoConfig,
    /// Options of [`Patch`].
    pub patch: PatchConfig,
}

impl FuseConfig {
    /// Checks the options of all methods.
    ///
    /// # Errors
    /// [`FuseError::Config`] names the option and what is possible.
    pub fn validate(&self) -> Result<(), FuseError> {
        self.normals.validate().map_err(|e| FuseError::Config(e.to_string()))?;
        self.surfel.validate().map_err(|e| FuseError::Config(e.to_string()))?;
        self.patch.validate()?;
        self.caminal.validate()?;
        self.roldao.validate()
    }
}

impl Method {
    /// All methods.
    pub const ALL: &[Self] = &[
        Self::Raycast,
        Self::Normals,
        Self::Surfel,
        Self::Cylindrical,
        Self::Kuehner,
        Self::Depth,
        Self::Caminal,
        Self::Roldao,
        Self::Patch,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Raycast => "raycast",
            Self::Normals => "normals",
            Self::Surfel => "surfel",
            Self::Cylindrical => "cylindrical",
            Self::Kuehner => "kuehner",
            Self::Depth => "depth",
            Self::Caminal => "caminal",
            Self::Roldao => "roldao",
            Self::Patch => "patch",
        }
    }

    /// The method's integrator. `sensor` is the model of the sensor, where it is known; methods that need one guess it from
    /// their first scan otherwise.
    pub fn build(self, config: &FuseConfig, sensor: Option<&SensorModel>) -> Box<dyn Integrator> {
        match self {
            Self::Raycast => Box::new(Raycast::new(config.raycast)),
            Self::Normals => Box::new(Normals::new(config.normals, sensor.cloned())),
            Self::Surfel => Box::new(Surfels::new(config.surfel, sensor)),
            Self::Cylindrical => Box::new(Cylindrical::new(sensor.cloned())),
            Self::Kuehner => Box::new(Kuehner::new(sensor.cloned())),
            Self::Depth => Box::<Depth>::default(),
            Self::Caminal => Box::new(Caminal::new(config.caminal, sensor.cloned())),
            Self::Roldao => Box::new(Roldao::new(config.roldao)),
            Self::Patch => Box::new(Patch::new(config.patch, sensor.cloned())),
        }
    }
}

impl std::str::FromStr for Method {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = || Self::ALL.iter().map(|m| m.name()).collect::<Vec<_>>().join(", ");
        Self::ALL
            .iter()
            .copied()
            .find(|m| m.name() == name)
            .ok_or_else(|| format!("no method {name}; there are {}", known()))
    }
}

/// A method of fusing scans.
pub trait Integrator: Send {
    /// Fuses one scan and says which blocks changed.
    ///
    /// The result does not depend on the number of threads, bit for bit. Invalid returns (see [`Scan::drop_invalid`]) that
    /// are still in the scan are skipped and counted.
    ///
    /// # Errors
    /// [`FuseError`]; the map is unchanged then.
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError>;

    /// Ends a series of scans: a method that collects them before it fuses does so now.
    fn finish(&mut self, _map: &mut VoxelMap) -> Integration {
        Integration::default()
    }
}

/// What one integration did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Integration {
    /// The blocks that were made or updated, each once.
    pub updated_blocks: Vec<BlockIndex>,
    /// Returns that reached the map.
    pub fused_returns: u64,
    /// Returns that could not be used, by reason.
    pub skipped: Skipped,
    /// Wall time of the method's own preparation (placing returns, normals, …), in seconds.
    pub prepare_secs: f64,
    /// Wall time of finding out which parts of the map returns reach into, in seconds.
    pub find_secs: f64,
}

/// Returns that a method did not use, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Skipped {
    /// Not finite, at the sensor's origin, or farther away than the grid reaches.
    pub outside_grid: u64,
    /// No surface normal could be estimated from the neighbours.
    pub without_normal: u64,
    /// The method gave it no weight.
    pub without_weight: u64,
    /// Outside the image that the method makes of the scan.
    pub outside_image: u64,
    /// Behind another return in the same pixel of that image.
    pub hidden: u64,
}

impl std::ops::AddAssign for Skipped {
    fn add_assign(&mut self, other: Self) {
        self.outside_grid += other.outside_grid;
        self.without_normal += other.without_normal;
        self.without_weight += other.without_weight;
        self.outside_image += other.outside_image;
        self.hidden += other.hidden;
    }
}

/// Why a scan cannot be fused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FuseError {
    /// The scan contradicts itself.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// An option has an impossible value.
    #[error("{0}")]
    Config(String),
    /// The method needs an organized scan, and neither the scan nor the sensor's model tells the laser of each return.
    #[error("{scan}: {reason}")]
    Unorganized {
        /// The scan's name.
        scan: String,
        /// What is missing, and what the user can do.
        reason: String,
    },
    /// The method needs an image that the scan does not give.
    #[error("{scan}: {reason}")]
    Image {
        /// The scan's name.
        scan: String,
        /// What is wrong.
        reason: String,
    },
    /// The sensor's position lies outside the grid or is not finite.
    #[error("{scan}: the sensor's position {position} lies outside the map's grid")]
    OutsideGrid {
        /// The scan's name.
        scan: String,
        /// World position.
        position: glam::DVec3,
    },
}

#[cfg(test)]
mod tests {
    use serde::de::value::{Error, StrDeserializer};

    use super::*;

    #[test]
    fn all_methods_are_listed_under_their_names() {
        let read = |name| Method::deserialize(StrDeserializer::<Error>::new(name));
        // The message names every method that there is.
        let told = read("none").unwrap_err().to_string();
        let known: Vec<&str> = told.split('`').skip(3).step_by(2).collect();
        let listed: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        assert_eq!(known, listed, "{told}");
        for &method in Method::ALL {
            assert_eq!((read(method.name()), method.name().parse()), (Ok(method), Ok(method)));
            method.build(&FuseConfig::default(), None);
        }
        assert!(
            "none"
                .parse::<Method>()
                .unwrap_err()
                .contains("no method none; there are raycast, ")
        );
    }

    #[test]
    fn the_defaults_make_sense() {
        assert_eq!(FuseConfig::default().validate(), Ok(()));
    }
}
