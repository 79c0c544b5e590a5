#![doc = include_str!("../README.md")]

mod along;
mod cells;
mod motion;
mod refiner;
mod register;
mod sample;
mod tracker;

pub use refiner::{Refined, Refiner, common_shift};
pub use tracker::{OdometryConfig, Quality, Tracked, Tracker};
