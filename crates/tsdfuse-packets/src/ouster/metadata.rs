//! Ouster's metadata: the JSON that the sensor's web interface, its SDK and its ROS driver write, of firmware 1 to 3.

use serde_json::Value;
use tsdfuse::glam::{DMat3, DMat4};
use tsdfuse::{Pose, SensorModel};

use super::imu::ImuProfile;
use crate::error::{PacketError, Result};

/// More than any sensor has.
const MAX_ROWS: usize = 1024;
const MAX_COLUMNS: usize = 16_384;

/// What is read of a sensor's metadata.
#[derive(Clone, Debug, PartialEq)]
pub struct Metadata {
    /// The model as its maker calls it: `OS-1-128`.
    pub product: String,
    /// Serial number, where told.
    pub serial: Option<u64>,
    /// The name of the packets' layout.
    pub profile: String,
    /// Of each row of the image, from the top, degrees.
    pub elevations_deg: Vec<f64>,
    /// See there.
    pub azimuths_deg: Vec<f64>,
    /// Of the range image, in one turn.
    pub columns_per_frame: usize,
    /// See there.
    pub columns_per_packet: usize,
    /// First and last column that is sent.
    pub window: [usize; 2],
    /// By how much the image's rows are shifted to make a picture, in columns.
    pub pixel_shifts: Vec<i32>,
    /// Where the sensor sits on what carries it, as the maker's SDK keeps it with the metadata.
    pub body_from_sensor: Option<Pose>,
    /// Ports of the packets, where told.
    pub lidar_port: Option<u16>,
    /// See there.
    pub imu_port: Option<u16>,
    /// From the axis of the lidar frame to where beams start: outwards and up.
    pub(super) beam_start_mm: [f64; 2],
    /// Millimetres.
    pub(super) sensor_from_lidar: DMat4,
    pub(super) sensor_from_imu: DMat3,
    pub(super) imu: ImuProfile,
    /// Whether the header counts frames with 32 bits, where told.
    pub(super) has_long_frame: Option<bool>,
    pub(super) notes: Vec<String>,
}

impl Metadata {
    /// Rows of the range image.
    pub fn rows(&self) -> usize {
        self.elevations_deg.len()
    }

    /// Columns that are sent of each frame.
    pub(super) fn window_columns(&self) -> usize {
        let [from, to] = self.window;
        let columns = self.columns_per_frame;
        (to + columns - from) % columns + 1
    }

    /// Packets that are sent of each frame.
    pub(super) fn window_packets(&self) -> usize {
        let [from, to] = self.window.map(|column| column / self.columns_per_packet);
        let all = self.columns_per_frame.div_ceil(self.columns_per_packet);
        if self.window_columns() == self.columns_per_frame {
            return all;
        }
        (to + all - from) % all + 1
    }

    /// The sensor's beams.
    pub fn model(&self, columns: u32) -> Option<SensorModel> {
        let letters = self.product.chars().filter(char::is_ascii_alphanumeric);
        let product: String = letters.map(|c| c.to_ascii_lowercase()).collect();
        let ranges_m = match product.get(..3) {
            Some("os0") => (0.3, 50.0),
            Some("os2") => (0.8, 240.0),
            Some("osd") => (0.3, 45.0),
            _ => (0.3, 120.0),
        };
        let mut elevations: Vec<f32> = self.elevations_deg.iter().map(|&e| e as f32).collect();
        elevations.sort_by(f32::total_cmp);
        for i in 1..elevations.len() {
            if elevations[i] <= elevations[i - 1] {
                elevations[i] = elevations[i - 1].next_up();
            }
        }
        SensorModel::from_beams(self.name(), elevations, columns, ranges_m).ok()
    }

    /// The sensor's name as on the command line: `os1-128`.
    pub fn name(&self) -> String {
        let mut parts = self.product.split('-').filter(|part| !part.is_empty());
        match (parts.next(), parts.next()) {
            (Some("OS"), Some(number)) if number.len() == 1 => format!("os{number}-{}", self.rows()),
            (Some(first), _) => format!("{}-{}", first.to_ascii_lowercase(), self.rows()),
            _ => format!("ouster-{}", self.rows()),
        }
    }

    /// Reads the JSON.
    ///
    /// # Errors
    /// Names what is missing or impossible.
    pub fn parse(text: &str) -> Result<Self> {
        let bad = |reason: String| PacketError::Calibration(format!("the metadata {reason}"));
        let json: Value = serde_json::from_str(text).map_err(|e| bad(format!("are no JSON: {e}")))?;
        let root = json.as_object().ok_or_else(|| bad("are no JSON object".to_owned()))?;
        // Of firmware 3, in parts; the sensor's web page writes some of these with other names.
        let parts = [
            "beam_intrinsics",
            "lidar_intrinsics",
            "imu_intrinsics",
            "sensor_info",
            "config_params",
            "lidar_data_format",
            "data_format",
        ];
        let part = |name: &str| root.get(name).and_then(Value::as_object);
        let find = |key: &str| {
            let nested = parts.iter().filter_map(|name| part(name)?.get(key));
            root.get(key).into_iter().chain(nested).find(|value| !value.is_null())
        };
        let text_of = |key: &str| find(key).and_then(Value::as_str).filter(|text| !text.is_empty());
        let numbers = |key: &str| -> Result<Option<Vec<f64>>> {
            let Some(list) = find(key) else { return Ok(None) };
            let read = list
                .as_array()
                .and_then(|list| list.iter().map(Value::as_f64).collect::<Option<Vec<_>>>());
            read.map(Some)
                .ok_or_else(|| bad(format!("have a {key} that is no list of numbers")))
        };
        let count = |key: &str| find(key).and_then(Value::as_u64).and_then(|n| usize::try_from(n).ok());
        let missing = |key: &str| bad(format!("have no {key}"));

        let elevations_deg = numbers("beam_altitude_angles")?.ok_or_else(|| missing("beam_altitude_angles"))?;
        let azimuths_deg = numbers("beam_azimuth_angles")?.ok_or_else(|| missing("beam_azimuth_angles"))?;
        let rows = elevations_deg.len();
        if !(1..=MAX_ROWS).contains(&rows) || azimuths_deg.len() != rows {
            let reason = format!(
                "have {rows} beam_altitude_angles and {} beam_azimuth_angles",
                azimuths_deg.len()
            );
            return Err(bad(reason));
        }
        if elevations_deg.iter().any(|e| e.abs() >= 90.0) || azimuths_deg.iter().any(|a| a.abs() > 360.0) {
            return Err(bad("have a beam with an impossible angle".to_owned()));
        }
        let mode = text_of("lidar_mode").and_then(|mode| mode.split('x').next()?.parse().ok());
        let columns_per_frame = count("columns_per_frame")
            .or(mode)
            .ok_or_else(|| missing("lidar_mode"))?;
        let columns_per_packet = count("columns_per_packet").unwrap_or(16);
        if !(1..=MAX_COLUMNS).contains(&columns_per_frame)
            || !(1..=crate::decoder::Head::COLUMNS).contains(&columns_per_packet)
        {
            let reason = format!("have {columns_per_frame} columns in a frame and {columns_per_packet} in a packet");
            return Err(bad(reason));
        }
        if count("pixels_per_column").is_some_and(|told| told != rows) {
            return Err(bad(format!("have {rows} beams but other pixels_per_column")));
        }
        let window = match numbers("column_window")?.as_deref() {
            Some(&[from, to]) => [from as usize, to as usize],
            _ => [0, columns_per_frame - 1],
        };
        if window.iter().any(|column| *column >= columns_per_frame) {
            return Err(bad(format!("have a column_window beyond {columns_per_frame} columns")));
        }
        let product = text_of("prod_line").unwrap_or("").to_owned();
        let mut notes = Vec::new();
        let matrix = |key: &str| -> Result<Option<DMat4>> {
            let Some(numbers) = numbers(key)? else { return Ok(None) };
            let rows: [f64; 16] = numbers
                .try_into()
                .map_err(|_| bad(format!("have a {key} that is no 4 x 4 matrix")))?;
            let matrix = DMat4::from_cols_array(&rows).transpose();
            let is_rigid = (matrix.determinant() - 1.0).abs() < 1e-3 && matrix.is_finite();
            is_rigid
                .then_some(Some(matrix))
                .ok_or_else(|| bad(format!("have a {key} that is no motion")))
        };
        let beam_start_mm = match (
            matrix("beam_to_lidar_transform")?,
            find("lidar_origin_to_beam_origin_mm"),
        ) {
            (Some(matrix), _) => [matrix.w_axis.x, matrix.w_axis.z],
            (None, Some(out)) => {
                let out = out.as_f64().filter(|out| out.abs() < 1e4);
                [
                    out.ok_or_else(|| bad("have a lidar_origin_to_beam_origin_mm that is no length".to_owned()))?,
                    0.0,
                ]
            }
            (None, None) => {
                notes.push(
                    "no lidar_origin_to_beam_origin_mm in the metadata: that of the first OS-1 is used".to_owned(),
                );
                [12.163, 0.0]
            }
        };
        let rotated = || {
            DMat4::from_cols_array_2d(&[
                [-1.0, 0.0, 0.0, 0.0],
                [0.0, -1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 36.18, 1.0],
            ])
        };
        let sensor_from_imu = matrix("imu_to_sensor_transform")?.unwrap_or(DMat4::IDENTITY);
        let extrinsic = part("ouster-sdk").and_then(|part| part.get("extrinsic")?.as_array());
        let body_from_sensor = extrinsic.map(|rows| {
            let rows: Option<Vec<f64>> = rows.iter().map(Value::as_f64).collect();
            let rows = rows.filter(|rows| rows.len() == 16);
            let pose = rows.and_then(|rows| Pose::from_row_major_3x4(rows.first_chunk()?).ok());
            pose.ok_or_else(|| bad("have an extrinsic that is no pose".to_owned()))
        });
        let port = |key: &str| {
            count(key)
                .and_then(|port| u16::try_from(port).ok())
                .filter(|&port| port > 0)
        };
        let shifts = numbers("pixel_shift_by_row")?.unwrap_or_default();
        Ok(Self {
            serial: text_of("prod_sn").and_then(|serial| serial.parse().ok()),
            profile: text_of("udp_profile_lidar").unwrap_or("LEGACY").to_owned(),
            sensor_from_lidar: matrix("lidar_to_sensor_transform")?.unwrap_or_else(rotated),
            sensor_from_imu: DMat3::from_mat4(sensor_from_imu),
            imu: ImuProfile::named(
                text_of("udp_profile_imu").unwrap_or("LEGACY"),
                count("imu_measurements_per_packet").unwrap_or(0),
            ),
            has_long_frame: text_of("header_type").map(|kind| kind == "FUSA"),
            pixel_shifts: shifts.into_iter().map(|shift| shift as i32).collect(),
            body_from_sensor: body_from_sensor.transpose()?,
            lidar_port: port("udp_port_lidar"),
            imu_port: port("udp_port_imu"),
            product,
            elevations_deg,
            azimuths_deg,
            columns_per_frame,
            columns_per_packet,
            window,
            beam_start_mm,
            notes,
        })
    }
}
