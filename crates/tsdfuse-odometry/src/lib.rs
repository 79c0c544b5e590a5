#![doc = include_str!("../README.md")]

mod along;
mod cells;
mod imu;
mod locate;
mod motion;
mod refiner;
mod register;
mod sample;
mod surfaces;
mod systematic;
mod tracker;

pub use imu::{ForetoldBy, ImuReport};
pub use locate::Search;
pub use refiner::{Refined, Refiner, common_shift};
pub use surfaces::{Fit, SurfacePoint, Surfaces};
pub use systematic::{BeamError, ErrorSums, SensorErrors};
pub use tracker::{OdometryConfig, Quality, Tracked, Tracker};
