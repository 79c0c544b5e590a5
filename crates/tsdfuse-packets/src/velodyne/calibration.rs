//! Calibration files of Velodyne: the YAML of the ROS driver, and the XML of VeloView.

use crate::error::{PacketError, Result};

/// More lasers than any of these sensors has.
const MAX_LASERS: usize = 1024;

/// Angles and offsets of each laser, by its number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// The lasers.
    pub lasers: Vec<Laser>,
    /// Metres for which a count of the range stands, where that is stated.
    pub range_unit_m: Option<f64>,
}

/// One laser.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Laser {
    /// Above the horizontal plane.
    pub elevation_rad: f64,
    /// By which the laser looks to the left of the azimuth.
    pub azimuth_rad: f64,
    /// Added to each range.
    pub range_offset_m: f64,
    /// The same, as measured close by, along x and y.
    pub near_range_offset_m: Option<[f64; 2]>,
    /// Where the laser sits: to the right and up.
    pub horizontal_offset_m: f64,
    /// See there.
    pub vertical_offset_m: f64,
    /// How intensity depends on range: the distance with the sharpest image, counts, and a factor.
    pub focal_distance: f64,
    /// See there.
    pub focal_slope: f64,
    /// Limits of the intensity, where stated.
    pub intensity_limits: Option<[f64; 2]>,
}

impl Laser {
    /// The corrected intensity of a return.
    pub(crate) fn intensity(&self, raw: u8, range: u16) -> f32 {
        if self.focal_slope == 0.0 {
            return f32::from(raw);
        }
        let focal_offset = 256.0 * (1.0 - self.focal_distance / 13_100.0).powi(2);
        let near = 256.0 * (1.0 - f64::from(range) / 65_535.0).powi(2);
        let [low, high] = self.intensity_limits.unwrap_or([0.0, 255.0]);
        let corrected = f64::from(raw) + self.focal_slope * (focal_offset - near).abs();
        corrected.max(low).min(high) as f32
    }

    fn set(&mut self, key: &str, value: f64) {
        match key {
            "vert_correction" => self.elevation_rad = value,
            "rot_correction" => self.azimuth_rad = value,
            "dist_correction" => self.range_offset_m = value,
            "horiz_offset_correction" => self.horizontal_offset_m = value,
            "vert_offset_correction" => self.vertical_offset_m = value,
            "focal_distance" => self.focal_distance = value,
            "focal_slope" => self.focal_slope = value,
            "dist_correction_x" => self.near_range_offset_m.get_or_insert_default()[0] = value,
            "dist_correction_y" => self.near_range_offset_m.get_or_insert_default()[1] = value,
            "min_intensity" => self.intensity_limits.get_or_insert([0.0, 255.0])[0] = value,
            "max_intensity" => self.intensity_limits.get_or_insert([0.0, 255.0])[1] = value,
            _ => {}
        }
    }
}

/// Lasers by their numbers, which must be 0, 1, 2, …
fn numbered(mut lasers: Vec<(usize, Laser)>, range_unit_m: Option<f64>) -> Result<Calibration> {
    lasers.sort_by_key(|(id, _)| *id);
    if lasers.is_empty() || lasers.iter().enumerate().any(|(i, (id, _))| i != *id) {
        let count = lasers.len();
        let reason = format!("the calibration has {count} lasers whose numbers are not 0, 1, 2, …");
        return Err(PacketError::calibration(reason));
    }
    let mut lasers: Vec<Laser> = lasers.into_iter().map(|(_, laser)| laser).collect();
    for (number, laser) in lasers.iter_mut().enumerate() {
        let is_possible = laser.elevation_rad.abs() < std::f64::consts::FRAC_PI_2
            && laser.azimuth_rad.abs() < std::f64::consts::PI
            && laser.range_offset_m.abs() < 100.0;
        if !is_possible {
            let reason = format!("laser {number} of the calibration has an impossible angle or range correction");
            return Err(PacketError::calibration(reason));
        }
        // As the driver: zeroes mean that close by nothing was measured.
        laser.near_range_offset_m = laser.near_range_offset_m.filter(|[x, y]| *x != 0.0 || *y != 0.0);
    }
    if range_unit_m.is_some_and(|unit| !(unit > 0.0 && unit < 1.0)) {
        return Err(PacketError::calibration(
            "the calibration's distance resolution is not possible",
        ));
    }
    Ok(Calibration { lasers, range_unit_m })
}

fn number(key: &str, value: &str) -> Result<f64> {
    let parsed = value.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    parsed.ok_or_else(|| PacketError::calibration(format!("{key} of the calibration is not a number: {value:.40}")))
}

/// The YAML of `velodyne_pointcloud`: a list `lasers` whose entries have one key and value after the other, as blocks or in
/// braces; angles in radians, lengths in metres.
pub(crate) fn parse_yaml(text: &str) -> Result<Calibration> {
    let is_between = |c: char| c.is_whitespace() || matches!(c, '{' | '}' | ',' | '[' | ']');
    let words = text
        .lines()
        .flat_map(|line| line.split('#').next().unwrap_or("").split(is_between));
    let mut words = words.filter(|word| !word.is_empty());
    let mut lasers: Vec<(usize, Laser)> = Vec::new();
    let mut range_unit_m = None;
    while let Some(word) = words.next() {
        if word == "-" {
            if lasers.len() >= MAX_LASERS {
                return Err(PacketError::calibration(format!(
                    "the calibration has more than {MAX_LASERS} lasers"
                )));
            }
            lasers.push((usize::MAX, Laser::default()));
        }
        let Some(key) = word.strip_suffix(':').filter(|key| *key != "lasers") else {
            continue;
        };
        let value = words.next().unwrap_or_default();
        match (key, lasers.last_mut()) {
            ("distance_resolution", _) => range_unit_m = Some(number(key, value)?),
            ("num_lasers", _) | (_, None) => {}
            ("laser_id", Some((id, _))) => *id = number(key, value)? as usize,
            ("two_pt_correction_available", _) => {}
            (_, Some((_, laser))) => laser.set(key, number(key, value)?),
        }
    }
    numbered(lasers, range_unit_m)
}

/// The XML of VeloView (`db.xml`): a `px` for each laser; angles in degrees, lengths in centimetres.
pub(crate) fn parse_xml(text: &str) -> Result<Calibration> {
    let mut lasers = Vec::new();
    for part in text.split("<px").skip(1) {
        let part = part.split("</px>").next().unwrap_or_default();
        let value = |name: &str| -> Result<Option<f64>> {
            let open = format!("<{name}>");
            let value = part.split_once(&open).and_then(|(_, rest)| rest.split('<').next());
            value.map(|value| number(name, value)).transpose()
        };
        let Some(id) = value("id_")? else { continue };
        if lasers.len() >= MAX_LASERS {
            return Err(PacketError::calibration(format!(
                "the calibration has more than {MAX_LASERS} lasers"
            )));
        }
        let cm = |name: &str| Ok::<_, PacketError>(value(name)?.unwrap_or(0.0) / 100.0);
        let near = [cm("distCorrectionX_")?, cm("distCorrectionY_")?];
        lasers.push((
            id as usize,
            Laser {
                elevation_rad: value("vertCorrection_")?.unwrap_or(0.0).to_radians(),
                azimuth_rad: value("rotCorrection_")?.unwrap_or(0.0).to_radians(),
                range_offset_m: cm("distCorrection_")?,
                near_range_offset_m: Some(near),
                horizontal_offset_m: cm("horizOffsetCorrection_")?,
                vertical_offset_m: cm("vertOffsetCorrection_")?,
                focal_distance: value("focalDistance_")?.unwrap_or(0.0),
                focal_slope: value("focalSlope_")?.unwrap_or(0.0),
                intensity_limits: None,
            },
        ));
    }
    let unit = text
        .split_once("<distLSB_>")
        .and_then(|(_, rest)| rest.split('<').next());
    let unit_cm = unit.map(|unit| number("distLSB_", unit)).transpose()?;
    // VeloView's files have places for 64 lasers; those that are not there have no angle at all.
    let used = lasers
        .iter()
        .rposition(|(_, laser)| laser.elevation_rad != 0.0 || laser.azimuth_rad != 0.0);
    let used = used.map_or(0, |last| last + 1);
    let wanted = [16, 32, 64, 128]
        .into_iter()
        .find(|&count| used <= count)
        .unwrap_or(used);
    lasers.truncate(wanted);
    numbered(lasers, unit_cm.map(|cm| cm / 100.0))
}
