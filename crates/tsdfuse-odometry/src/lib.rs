#![doc = include_str!("../README.md")]

mod along;
mod bridge;
mod calibrate;
mod cells;
mod imu;
mod locate;
mod motion;
mod mounting;
mod refiner;
mod register;
mod returns;
mod sample;
mod sticking;
mod surfaces;
mod systematic;
mod tracker;

pub use bridge::bridge;
pub use calibrate::shared_errors;
pub use imu::{ImuReport, PredictedBy};
pub use locate::Search;
pub use mounting::{Mounting, mounting};
pub use refiner::{Refined, Refiner, common_shift};
pub use surfaces::{Fit, SurfacePoint, Surfaces};
pub use systematic::{Calibrate, ErrorSums};
pub use tracker::{OdometryConfig, Quality, Tracked, Tracker};
