#![doc = include_str!("../README.md")]

mod bytes;
mod calibration;
mod cutter;
mod decoder;
mod error;
#[doc(hidden)]
pub mod fuzzing;
pub mod hesai;
pub mod ouster;
mod position;
mod returns;
mod sensor;
pub mod velodyne;

pub use calibration::Calibration;
pub use decoder::{Counts, Decoder, Place, Sweep};
pub use error::{PacketError, Result};
pub use position::Position;
pub use sensor::{Maker, Sensor};
