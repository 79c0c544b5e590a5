#![doc = include_str!("../README.md")]

mod along;
mod cells;
mod motion;
mod register;
mod sample;
mod tracker;

pub use tracker::{OdometryConfig, Quality, Tracked, Tracker};
