//! Where the returns of a range image's pixels lie.

use tsdfuse::glam::{DMat4, DVec3, Vec3};

use super::Metadata;

/// The beams of an Ouster, ready to place its returns in the sensor's frame.
#[derive(Clone, Debug)]
pub struct Beams {
    /// Of each row, as it looks at column 0: from where the beam starts, not from the axis.
    directions: Vec<DVec3>,
    /// Cosine and sine of each column's angle.
    turns: Vec<(f64, f64)>,
    /// From the axis to where beams start: outwards and up; and how long that is.
    out_mm: f64,
    up_mm: f64,
    start_mm: f64,
    sensor_from_lidar: DMat4,
}

impl Beams {
    /// The beams that the metadata describe.
    pub fn new(metadata: &Metadata) -> Self {
        let direction = |(&elevation, &azimuth): (&f64, &f64)| {
            let (sin_e, cos_e) = elevation.to_radians().sin_cos();
            let (sin_a, cos_a) = (-azimuth).to_radians().sin_cos();
            DVec3::new(cos_a * cos_e, sin_a * cos_e, sin_e)
        };
        let columns = metadata.columns_per_frame;
        let turn = |column: usize| {
            let (sin, cos) = (-std::f64::consts::TAU * column as f64 / columns as f64).sin_cos();
            (cos, sin)
        };
        let [out_mm, up_mm] = metadata.beam_start_mm;
        Self {
            directions: metadata
                .elevations_deg
                .iter()
                .zip(&metadata.azimuths_deg)
                .map(direction)
                .collect(),
            turns: (0..columns).map(turn).collect(),
            out_mm,
            up_mm,
            start_mm: if up_mm == 0.0 { out_mm } else { out_mm.hypot(up_mm) },
            sensor_from_lidar: metadata.sensor_from_lidar,
        }
    }

    /// The return of a pixel, metres in the sensor's frame; NaN beyond the image.
    #[inline]
    pub fn point(&self, row: usize, column: usize, range_mm: u32) -> Vec3 {
        let (Some(direction), Some(&(cos, sin))) = (self.directions.get(row), self.turns.get(column)) else {
            return Vec3::NAN;
        };
        let along = *direction * (f64::from(range_mm) - self.start_mm);
        let (x, y) = (along.x + self.out_mm, along.y);
        let in_lidar = DVec3::new(cos * x - sin * y, sin * x + cos * y, along.z + self.up_mm);
        (self.sensor_from_lidar.transform_point3(in_lidar) * 1e-3).as_vec3()
    }
}
