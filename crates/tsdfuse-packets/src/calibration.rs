//! Angles and offsets of one sensor, from the maker's files.

use tsdfuse::Pose;

use crate::error::{PacketError, Result};
use crate::{hesai, ouster, velodyne};

/// What is known of one sensor beyond its model.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Calibration {
    /// Nothing: the model's nominal angles, or those that its packets tell.
    #[default]
    Nominal,
    /// Of Velodyne's: the YAML of its ROS driver, or the XML of VeloView.
    Velodyne(velodyne::Calibration),
    /// Of Hesai's: its CSV of angles.
    Hesai(hesai::Angles),
    /// Of Ouster's: its metadata, JSON.
    Ouster(Box<ouster::Metadata>),
}

impl Calibration {
    /// Where the sensor sits on what carries it, where the file tells: Ouster's SDK keeps that with the metadata.
    pub fn body_from_sensor(&self) -> Option<Pose> {
        match self {
            Self::Ouster(metadata) => metadata.body_from_sensor,
            _ => None,
        }
    }

    /// Reads a calibration; what kind it is, is seen from its content.
    ///
    /// # Errors
    /// If it is of no kind that is known, or holds what no sensor has.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let text = std::str::from_utf8(bytes)
            .map_err(|_| PacketError::calibration("is no text: a calibration is JSON, CSV, YAML or XML"))?;
        let start = text.trim_start_matches('\u{feff}').trim_start();
        if start.starts_with('{') {
            ouster::Metadata::parse(start).map(|metadata| Self::Ouster(Box::new(metadata)))
        } else if start.starts_with('<') {
            velodyne::parse_xml(text).map(Self::Velodyne)
        } else if text.contains("lasers:") {
            velodyne::parse_yaml(text).map(Self::Velodyne)
        } else {
            hesai::parse_csv(text).map(Self::Hesai)
        }
    }
}
