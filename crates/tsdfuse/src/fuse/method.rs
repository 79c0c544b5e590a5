//! The methods by name. This file is where a method is registered: one line in `methods!`, and a field of [`FuseConfig`] if it has
//! options.

use serde::{Deserialize, Serialize};

use super::{
    Caminal, CaminalConfig, Cylindrical, Depth, FuseError, Integrator, Kuehner, KuehnerConfig, Normals, Patch,
    PatchConfig, Raycast, RaycastConfig, Roldao, RoldaoConfig, Surfels,
};
use crate::{normals::NormalsConfig, sensor::SensorModel, surfel::SurfelConfig};

/// Makes [`Method`] of lines that say: the type of the integrator, the method's name, and how the integrator is built from the options
/// and the sensor's model.
macro_rules! methods {
    ($($(#[$attribute:meta])* $method:ident $name:literal: |$config:pat_param, $sensor:pat_param| $build:expr;)*) => {
        /// The methods, by name.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
        pub enum Method {
            $(
                #[doc = concat!("`", $name, "`: [`", stringify!($method), "`].")]
                $(#[$attribute])*
                #[serde(rename = $name)]
                $method,
            )*
        }

        impl Method {
            /// All methods.
            pub const ALL: &[Self] = &[$(Self::$method),*];

            /// The name on the command line and in files.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$method => $name,)*
                }
            }

            /// The method's integrator. `sensor` is the model of the sensor, where it is known; methods that need one guess it
            /// from their first scan otherwise ([`Integrator::needs_sensor`]).
            pub fn build(self, config: &FuseConfig, sensor: Option<&SensorModel>) -> Box<dyn Integrator> {
                match self {
                    $(Self::$method => {
                        let ($config, $sensor) = (config, sensor);
                        Box::new($build)
                    })*
                }
            }
        }
    };
}

methods! {
    Raycast "raycast": |config, _| Raycast::new(config.raycast);
    Normals "normals": |config, sensor| Normals::new(config.normals, sensor.cloned());
    Surfels "surfel": |config, sensor| Surfels::new(config.surfel, sensor);
    Cylindrical "cylindrical": |_, sensor| Cylindrical::new(sensor.cloned());
    Kuehner "kuehner": |config, sensor| Kuehner::new(config.kuehner, sensor.cloned());
    Depth "depth": |_, _| Depth::default();
    Caminal "caminal": |config, sensor| Caminal::new(config.caminal, sensor.cloned());
    Roldao "roldao": |config, _| Roldao::new(config.roldao);
    #[default]
    Patch "patch": |config, sensor| Patch::new(config.patch, sensor.cloned());
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
    /// Options of [`Kuehner`].
    pub kuehner: KuehnerConfig,
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
        self.kuehner.validate()?;
        self.caminal.validate()?;
        self.roldao.validate()
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
