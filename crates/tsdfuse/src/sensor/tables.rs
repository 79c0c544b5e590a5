//! Beam tables of known sensors.
//!
//! All are nominal: a manufacturer's table or its stated field of view, not the calibration of one unit. Ranges are those
//! at which a return is worth fusing. Sources:
//!
//! | name | beams | source |
//! |---|---|---|
//! | `pandar64` | 64, 14.882° … −24.897°, 1/6° apart in the middle | Hesai's nominal table, confirmed on PandaSet to 0.004° |
//! | `hdl64e` | two blocks of 32: −24.8° … −8.83° and −8.33° … 2° | Velodyne HDL-64E manual; ½° and ⅓° apart |
//! | `hdl32e` | 32, −30.67° … 10.67° in steps of 4/3° | Velodyne HDL-32E manual, table of the firing order |
//! | `vlp16` | 16, ±15° in steps of 2° | Velodyne VLP-16 manual |
//! | `os0-128` | 128, ±45° | Ouster OS0 data sheet: 90° field of view, uniform |
//! | `os1-128`, `os1-64` | 128 or 64, ±22.5° | Ouster OS1 data sheet: 45° field of view, uniform |
//! | `os1-64-gen1` | 64, ±16.611° | Ouster's default angles for the first OS-1: 33.2° field of view |

use super::SensorModel;

/// Hesai Pandar64, degrees, from the top.
const PANDAR64_DEG: [f32; 64] = [
    14.882, 11.032, 8.059, 5.057, 3.04, 2.028, 1.86, 1.688, 1.522, 1.351, 1.184, 1.013, 0.846, 0.675, 0.508, 0.337,
    0.169, 0.0, -0.169, -0.337, -0.508, -0.675, -0.845, -1.013, -1.184, -1.351, -1.522, -1.688, -1.86, -2.028, -2.198,
    -2.365, -2.536, -2.7, -2.873, -3.04, -3.21, -3.375, -3.548, -3.712, -3.884, -4.05, -4.221, -4.385, -4.558, -4.72,
    -4.892, -5.057, -5.229, -5.391, -5.565, -5.726, -5.898, -6.061, -7.063, -8.059, -9.06, -9.885, -11.032, -12.006,
    -12.974, -13.93, -18.889, -24.897,
];

/// Names that [`model`] knows, as the command line prints them.
const NAMES: [&str; 8] = [
    "pandar64",
    "hdl64e",
    "hdl32e",
    "vlp16",
    "os0-128",
    "os1-64",
    "os1-128",
    "os1-64-gen1",
];

/// The names of the known sensors.
pub fn names() -> &'static [&'static str] {
    &NAMES
}

/// The model of a known sensor; case, hyphens, underscores and blanks in `name` do not matter (`VLP-16`, `os1_64`).
pub fn model(name: &str) -> Option<SensorModel> {
    let key = |s: &str| -> String {
        let letters = s.chars().filter(|c| !matches!(c, '-' | '_' | ' '));
        letters.map(|c| c.to_ascii_lowercase()).collect()
    };
    let asked = key(name);
    let asked = match asked.as_str() {
        "hesaipandar64" => "pandar64",
        "velodyne16" | "vlp16puck" => "vlp16",
        "velodyne32" | "hdl32" => "hdl32e",
        "velodyne64" | "hdl64" => "hdl64e",
        other => other,
    };
    let name = names().iter().find(|n| key(n) == asked)?;
    let (elevations_deg, columns, min_range_m, max_range_m) = match *name {
        "pandar64" => (PANDAR64_DEG.iter().rev().copied().collect(), 1800, 0.3, 200.0),
        "hdl64e" => {
            let (lower, upper) = (evenly(-24.8, -8.83, 32), evenly(-8.33, 2.0, 32));
            ([lower, upper].concat(), 2083, 0.9, 120.0)
        }
        "hdl32e" => (evenly(-92.0 / 3.0, 32.0 / 3.0, 32), 2170, 1.0, 100.0),
        "vlp16" => (evenly(-15.0, 15.0, 16), 1800, 0.9, 100.0),
        "os0-128" => (evenly(-45.0, 45.0, 128), 1024, 0.3, 50.0),
        "os1-64" => (evenly(-22.5, 22.5, 64), 1024, 0.3, 120.0),
        "os1-128" => (evenly(-22.5, 22.5, 128), 1024, 0.3, 120.0),
        "os1-64-gen1" => (evenly(-16.611, 16.611, 64), 1024, 0.8, 120.0),
        _ => return None,
    };
    Some(SensorModel {
        name: (*name).to_owned(),
        elevations_deg,
        columns,
        min_range_m,
        max_range_m,
    })
}

/// `count` angles from `first` to `last`, both included.
fn evenly(first: f64, last: f64, count: u32) -> Vec<f32> {
    let step = (last - first) / f64::from(count - 1);
    (0..count).map(|i| (first + f64::from(i) * step) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_known_sensor_is_a_valid_model() {
        for name in names() {
            let model = model(name).unwrap();
            assert_eq!(model.name, *name);
            model.check().unwrap();
        }
    }

    #[test]
    fn spelling_does_not_matter_and_the_unknown_is_none() {
        for (asked, want) in [
            ("VLP-16", "vlp16"),
            ("os1_64", "os1-64"),
            ("Pandar 64", "pandar64"),
            ("HDL-64", "hdl64e"),
        ] {
            assert_eq!(model(asked).unwrap().name, want);
        }
        assert_eq!(model("mid360"), None);
        assert_eq!(model(""), None);
    }

    #[test]
    fn tables_hold_the_published_angles() {
        let hdl32e = model("hdl32e").unwrap().elevations_deg;
        for (ring, want) in [(0, -30.67), (1, -29.33), (16, -9.33), (23, 0.0), (31, 10.67)] {
            assert!((hdl32e[ring] - want).abs() < 0.005, "{ring}");
        }
        let hdl64e = model("hdl64e").unwrap().elevations_deg;
        assert_eq!((hdl64e.len(), hdl64e[31], hdl64e[32]), (64, -8.83, -8.33));
        let vlp16 = model("vlp16").unwrap().elevations_deg;
        assert_eq!((vlp16[0], vlp16[7], vlp16[15]), (-15.0, -1.0, 15.0));
    }
}
