//! The makers' profiles: where range, signal and reflectivity are in a pixel.

use super::metadata::Metadata;
use crate::error::{PacketError, Result};

/// How a pixel is laid out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Profile {
    /// Headers of columns, not of packets.
    pub(super) is_legacy: bool,
    /// The frame's number has 32 bits, elsewhere in the header.
    pub(super) has_long_frame: bool,
    /// Bytes of a pixel.
    pub(super) pixel: usize,
    /// Of the 32 bits at a range, these are it, in steps of 2^shift millimetres.
    pub(super) range_mask: u32,
    pub(super) range_shift: u32,
    pub(super) echoes: &'static [Echo],
}

/// Offsets in the pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Echo {
    pub(super) range: usize,
    pub(super) reflectivity: usize,
    /// 16 bits, where there is one.
    pub(super) signal: Option<usize>,
}

const fn echo(range: usize, reflectivity: usize, signal: Option<usize>) -> Echo {
    Echo {
        range,
        reflectivity,
        signal,
    }
}

const SINGLE: &[Echo] = &[echo(0, 4, Some(6))];
const DUAL: &[Echo] = &[echo(0, 3, Some(8)), echo(4, 7, Some(10))];
const LOW: &[Echo] = &[echo(0, 2, None)];
const LOW_DUAL: &[Echo] = &[echo(0, 2, None), echo(4, 6, None)];
const COLOUR: &[Echo] = &[echo(0, 3, Some(4))];

impl Profile {
    /// That of a sensor.
    ///
    /// # Errors
    /// If it is not known, or sends no returns.
    pub(super) fn of(metadata: &Metadata) -> Result<Self> {
        let named = Self::named(&metadata.profile)?;
        let has_long_frame = metadata.has_long_frame.unwrap_or(named.has_long_frame);
        Ok(Self {
            has_long_frame: has_long_frame && !named.is_legacy,
            ..named
        })
    }

    fn named(name: &str) -> Result<Self> {
        let fine = |pixel, echoes| Self {
            is_legacy: false,
            has_long_frame: false,
            pixel,
            range_mask: 0x7_FFFF,
            range_shift: 0,
            echoes,
        };
        let low = |pixel, echoes| Self {
            range_mask: 0x7FFF,
            range_shift: 3,
            ..fine(pixel, echoes)
        };
        Ok(match name {
            "LEGACY" => Self {
                is_legacy: true,
                range_mask: 0xF_FFFF,
                ..fine(12, SINGLE)
            },
            "RNG19_RFL8_SIG16_NIR16" | "RNG19_RFL8_SIG16_NIR16_ZONE16" => fine(12, SINGLE),
            "RNG19_RFL8_SIG16_NIR16_DUAL" | "RNG19_RFL8_SIG16_ZONE16_DUAL" => fine(16, DUAL),
            "FIVE_WORD_PIXEL" => fine(20, DUAL),
            "RNG19_RFL8_SIG16_NIR16_RGB16" => fine(16, COLOUR),
            "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL" => fine(20, DUAL),
            "RNG15_RFL8_NIR8" | "RNG15_RFL8_WIN8" => low(4, LOW),
            "RNG15_RFL8_NIR8_ZONE16" => low(8, LOW),
            "RNG15_RFL8_NIR8_DUAL" => low(8, LOW_DUAL),
            "FUSA_RNG15_RFL8_NIR8_DUAL" => Self {
                has_long_frame: true,
                ..low(8, LOW_DUAL)
            },
            "OFF" => {
                let reason = "the metadata say that the sensor sends no returns: udp_profile_lidar is OFF";
                return Err(PacketError::calibration(reason));
            }
            other => {
                let reason = format!("the metadata name a profile that is not known: {other:.60}");
                return Err(PacketError::calibration(reason));
            }
        })
    }
}
