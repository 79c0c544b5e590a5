//! Which sensor sends a packet.

use crate::{hesai, ouster, velodyne};

/// A maker of LiDARs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Maker {
    /// Velodyne LiDAR.
    Velodyne,
    /// Hesai Technology.
    Hesai,
    /// Ouster.
    Ouster,
}

/// A model of a LiDAR whose packets are decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Sensor {
    /// Velodyne VLP-16 (Puck, Puck LITE).
    Vlp16,
    /// Velodyne Puck Hi-Res.
    Vlp16HiRes,
    /// Velodyne HDL-32E.
    Hdl32e,
    /// Velodyne VLP-32C (Ultra Puck).
    Vlp32c,
    /// Velodyne HDL-64E.
    Hdl64e,
    /// Velodyne VLS-128 (Alpha Prime).
    Vls128,
    /// Hesai Pandar40P.
    Pandar40p,
    /// Hesai Pandar64.
    Pandar64,
    /// Hesai PandarQT64.
    Qt64,
    /// Hesai QT128.
    Qt128,
    /// Hesai PandarXT-16.
    Xt16,
    /// Hesai PandarXT-32.
    Xt32,
    /// Hesai PandarXT-32M.
    Xt32m,
    /// Hesai Pandar128.
    Pandar128,
    /// Hesai OT128.
    Ot128,
    /// Any of Ouster: its metadata say which.
    Ouster,
}

impl Sensor {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::Vlp16,
        Self::Vlp16HiRes,
        Self::Hdl32e,
        Self::Vlp32c,
        Self::Hdl64e,
        Self::Vls128,
        Self::Pandar40p,
        Self::Pandar64,
        Self::Qt64,
        Self::Qt128,
        Self::Xt16,
        Self::Xt32,
        Self::Xt32m,
        Self::Pandar128,
        Self::Ot128,
        Self::Ouster,
    ];

    /// Lower-case name as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vlp16 => "vlp16",
            Self::Vlp16HiRes => "vlp16-hires",
            Self::Hdl32e => "hdl32e",
            Self::Vlp32c => "vlp32c",
            Self::Hdl64e => "hdl64e",
            Self::Vls128 => "vls128",
            Self::Pandar40p => "pandar40p",
            Self::Pandar64 => "pandar64",
            Self::Qt64 => "qt64",
            Self::Qt128 => "qt128",
            Self::Xt16 => "xt16",
            Self::Xt32 => "xt32",
            Self::Xt32m => "xt32m",
            Self::Pandar128 => "pandar128",
            Self::Ot128 => "ot128",
            Self::Ouster => "ouster",
        }
    }

    /// The sensor of that name; case, hyphens, underscores and blanks do not matter, nor do the makers' names in front.
    pub fn named(name: &str) -> Option<Self> {
        let key = |s: &str| -> String {
            let letters = s.chars().filter(char::is_ascii_alphanumeric);
            letters.map(|c| c.to_ascii_lowercase()).collect()
        };
        let asked = key(name);
        let asked = asked.trim_start_matches("velodyne").trim_start_matches("hesai");
        let asked = match asked {
            "vlp32" => "vlp32c",
            "hdl32" => "hdl32e",
            "hdl64" => "hdl64e",
            "40p" | "pandar40" => "pandar40p",
            "64" => "pandar64",
            "128e3x" | "pandar128e3x" => "pandar128",
            "128e4x" | "pandar128e4x" => "ot128",
            other if other == "ouster" || ["os0", "os1", "os2", "osdome"].iter().any(|os| other.starts_with(os)) => {
                "ouster"
            }
            other => other
                .strip_prefix("pandar")
                .filter(|s| s.starts_with(['q', 'x']))
                .unwrap_or(other),
        };
        Self::ALL.into_iter().find(|sensor| key(sensor.name()) == asked)
    }

    /// Who makes it.
    pub fn maker(self) -> Maker {
        match self {
            Self::Vlp16 | Self::Vlp16HiRes | Self::Hdl32e | Self::Vlp32c | Self::Hdl64e | Self::Vls128 => {
                Maker::Velodyne
            }
            Self::Ouster => Maker::Ouster,
            _ => Maker::Hesai,
        }
    }

    /// What is told where the sensor's own angles are not known.
    pub(crate) fn nominal_note(self) -> String {
        format!(
            "no calibration: the angles are a {}'s nominal ones; --calibration FILE gives this sensor's own",
            self.name()
        )
    }

    /// The sensor that sends packets like this one, as far as length, marks and the bytes for it tell.
    pub fn recognise(payload: &[u8]) -> Option<Self> {
        let hesai = || hesai::recognise(payload);
        velodyne::recognise(payload)
            .or_else(hesai)
            .or_else(|| ouster::recognise(payload))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_found_however_they_are_spelt() {
        for sensor in Sensor::ALL {
            assert_eq!(Sensor::named(sensor.name()), Some(sensor));
        }
        for (name, sensor) in [
            ("VLP-16", Sensor::Vlp16),
            ("Velodyne VLP-32", Sensor::Vlp32c),
            ("PandarXT-32", Sensor::Xt32),
            ("Pandar XT32M", Sensor::Xt32m),
            ("HesaiPandar64", Sensor::Pandar64),
            ("PandarQT64", Sensor::Qt64),
            ("Pandar128E4X", Sensor::Ot128),
            ("os1-128", Sensor::Ouster),
        ] {
            assert_eq!(Sensor::named(name), Some(sensor), "{name}");
        }
        assert_eq!(Sensor::named("mid360"), None);
        assert_eq!(Sensor::named(""), None);
    }
}
