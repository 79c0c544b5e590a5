//! The points of a message: which of its columns are what, and what is in them.

use tsdfuse::glam::Vec3;

use super::point_times::{PointTimes, Sighting};
use super::value::Rows;
use crate::scalar::Scalar;

/// Clouds with this many rows, and at least twice as many columns, have one laser a row.
const ROWS_OF_LASERS: std::ops::RangeInclusive<usize> = 8..=256;
const TIMES: &[&str] = &[
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "offset_time",
    "time_offset",
    "deltatime",
    "delta_time",
    "stamp",
    "timestamps",
];
const RINGS: &[&str] = &["ring", "channel", "line", "laser_id", "laser", "ring_id", "beam"];
const INTENSITIES: &[&str] = &["intensity", "intensities", "reflectivity", "reflectance", "i"];

/// A number of each record.
#[derive(Clone, Copy, Debug)]
struct Column {
    field: usize,
    offset: usize,
    scalar: Scalar,
}

impl Column {
    fn read(self, record: &[u8], is_big_endian: bool) -> Option<f64> {
        self.scalar.read_as(record.get(self.offset..)?, is_big_endian)
    }
}

/// The columns that make up a cloud.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Columns {
    xyz: [Column; 3],
    intensity: Option<Column>,
    ring: Option<Column>,
    time: Option<Column>,
}

/// What the columns of a message hold.
#[derive(Debug, Default)]
pub(crate) struct Points {
    pub(crate) points: Vec<Vec3>,
    pub(crate) rings: Option<Vec<u16>>,
    pub(crate) intensities: Option<Vec<f32>>,
    /// Seconds after the message's stamp.
    pub(crate) secs: Option<Vec<f32>>,
}

impl Columns {
    /// Finds the columns by their names.
    ///
    /// # Errors
    /// Names the one of x, y and z that is missing.
    pub(crate) fn find(rows: &Rows<'_>) -> Result<Self, String> {
        let column = |names: &[&str]| {
            let field = rows.find(names)?;
            let (_, offset, scalar) = *rows.row.fields.get(field)?;
            Some(Column { field, offset, scalar })
        };
        let [x, y, z] = ["x", "y", "z"].map(|name| column(&[name]).ok_or_else(|| format!("has no field {name}")));
        Ok(Self {
            xyz: [x?, y?, z?],
            intensity: column(INTENSITIES),
            ring: column(RINGS),
            time: column(TIMES),
        })
    }

    /// The names of the fields that were taken for intensities, rings and times.
    pub(crate) fn names<'a>(&self, rows: &'a Rows<'_>) -> [Option<&'a str>; 3] {
        [self.intensity, self.ring, self.time].map(|column| Some(rows.row.fields.get(column?.field)?.0.as_str()))
    }

    fn is_valid(&self, record: &[u8], is_big_endian: bool) -> bool {
        let xyz = self
            .xyz
            .map(|column| column.read(record, is_big_endian).unwrap_or(f64::NAN));
        xyz.iter().all(|v| v.is_finite()) && xyz != [0.0; 3]
    }

    /// The first and the last time of a message's valid points; `None` without a column of times.
    pub(crate) fn sighting(&self, rows: &Rows<'_>, stamp_ns: i64) -> Option<Sighting> {
        let (time, turned) = (self.time?, rows.row.is_big_endian);
        let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
        for record in rows.iter().filter(|record| self.is_valid(record, turned)) {
            let t = time.read(record, turned).filter(|t| t.is_finite());
            if let Some(t) = t {
                (first, last) = (first.min(t), last.max(t));
            }
        }
        Some(Sighting { stamp_ns, first, last })
    }

    /// Reads all points of a message. Invalid ones are kept as they are.
    ///
    /// # Errors
    /// Names the point whose ring is none.
    pub(crate) fn read(&self, rows: &Rows<'_>, times: Option<&PointTimes>, stamp_ns: i64) -> Result<Points, String> {
        let mut read = Points {
            points: self.points(rows),
            ..Points::default()
        };
        let turned = rows.row.is_big_endian;
        let values = |column: Column| {
            rows.iter()
                .map(move |record| column.read(record, turned).unwrap_or(f64::NAN))
        };
        if let Some(column) = self.intensity {
            let mut intensities = Vec::with_capacity(rows.len());
            intensities.extend(values(column).map(|v| v as f32));
            read.intensities = Some(intensities);
        }
        if let Some(column) = self.ring {
            let mut rings = Vec::with_capacity(rows.len());
            for (point, v) in values(column).enumerate() {
                // A point that is none may have any ring.
                let is_ring = v >= 0.0 && v <= f64::from(u16::MAX) && v.fract() == 0.0;
                if !is_ring
                    && read
                        .points
                        .get(point)
                        .is_some_and(|p| p.is_finite() && *p != Vec3::ZERO)
                {
                    return Err(format!("point {point}: {v} is no ring number"));
                }
                rings.push(if is_ring { v as u16 } else { 0 });
            }
            read.rings = Some(rings);
        } else if ROWS_OF_LASERS.contains(&rows.rows) && rows.row.count >= 2 * rows.rows {
            let rings = (0..rows.rows).flat_map(|row| std::iter::repeat_n(row as u16, rows.row.count));
            read.rings = Some(rings.collect());
        }
        if let (Some(column), Some(times)) = (self.time, times) {
            let earliest = values(column).filter(|t| t.is_finite()).fold(f64::INFINITY, f64::min);
            let base = times.base(stamp_ns, earliest);
            let mut secs = Vec::with_capacity(rows.len());
            secs.extend(values(column).map(|raw| times.secs(raw, base)));
            read.secs = Some(secs);
        }
        Ok(read)
    }

    fn points(&self, rows: &Rows<'_>) -> Vec<Vec3> {
        let turned = rows.row.is_big_endian;
        let mut points = Vec::with_capacity(rows.len());
        let [x, y, z] = self.xyz;
        let is_plain = !turned
            && [x, y, z].iter().all(|column| column.scalar == Scalar::F32)
            && y.offset == x.offset + 4
            && z.offset == x.offset + 8;
        if is_plain {
            let point = |record: &[u8]| {
                let xyz: &[u8; 12] = record.get(x.offset..)?.first_chunk()?;
                let [x, y, z] =
                    [0, 4, 8].map(|at| f32::from_le_bytes([xyz[at], xyz[at + 1], xyz[at + 2], xyz[at + 3]]));
                Some(Vec3::new(x, y, z))
            };
            points.extend(rows.iter().map(|record| point(record).unwrap_or(Vec3::NAN)));
        } else {
            let value = |column: Column, record: &[u8]| column.read(record, turned).unwrap_or(f64::NAN) as f32;
            points.extend(rows.iter().map(|r| Vec3::new(value(x, r), value(y, r), value(z, r))));
        }
        points
    }
}
