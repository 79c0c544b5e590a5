//! What the named columns of PCD and PLY clouds mean.
//!
//! The case of a name does not matter, nor does a leading `scalar_` (CloudCompare):
//!
//! | column | names | unit |
//! |---|---|---|
//! | point | `x` `y` `z` | metres, sensor frame |
//! | intensity | `intensity`, `intensities`, `reflectivity`, `reflectance`, `i` | as it is |
//! | ring | `ring`, `laser_id`, `laser`, `channel`, `line` | renumbered so that 0 is the lowest |
//! | time | `t`, `time`, `timestamp`, `time_offset`, `offset_time`, `gps_time` | integers: nanoseconds; others: seconds, or since 1970 in s, ms, µs or ns |
//!
//! Times count from the scan's pose (Ouster, Velodyne) or from an epoch (Hesai).

use std::path::Path;

use tsdfuse::glam::{DVec3, Vec3};

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::files::epoch_secs;
use crate::scalar::Scalar;

/// What a column can be in a cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    X,
    Y,
    Z,
    Intensity,
    Ring,
    Time,
}

/// The column names of each role, the preferred ones first.
const NAMES: [(Role, &[&str]); 6] = [
    (Role::X, &["x"]),
    (Role::Y, &["y"]),
    (Role::Z, &["z"]),
    (
        Role::Intensity,
        &["intensity", "intensities", "reflectivity", "reflectance", "i"],
    ),
    (Role::Ring, &["ring", "laser_id", "laser", "channel", "line"]),
    (
        Role::Time,
        &["t", "time", "timestamp", "time_offset", "offset_time", "gps_time"],
    ),
];

/// The columns of a cloud that is being read.
#[derive(Debug)]
pub(crate) struct Columns([Option<Column>; 6]);

#[derive(Debug)]
struct Column {
    /// The number of the field in the file.
    field: usize,
    scalar: Scalar,
    values: Vec<f64>,
}

impl Columns {
    /// Picks from the fields of a file those that make up a cloud; x, y and z must be among them.
    pub(crate) fn pick(path: &Path, fields: &[(&str, Scalar)]) -> Result<Self> {
        let plain = |name: &str| {
            let name = name.to_ascii_lowercase();
            name.strip_prefix("scalar_").map(str::to_owned).unwrap_or(name)
        };
        let plain: Vec<_> = fields.iter().map(|(name, _)| plain(name)).collect();
        let columns = NAMES.map(|(_, names)| {
            let field = names.iter().find_map(|name| plain.iter().position(|p| p == name))?;
            Some(Column {
                field,
                scalar: fields[field].1,
                values: Vec::new(),
            })
        });
        if let Some(missing) = columns[..3].iter().position(Option::is_none) {
            let reason = format!("has no field {}", NAMES[missing].1[0]);
            return Err(Error::format(path, reason));
        }
        Ok(Self(columns))
    }

    /// The columns to be filled, each with the number and type of its field in the file.
    pub(crate) fn each(&mut self) -> impl Iterator<Item = (usize, Scalar, &mut Vec<f64>)> {
        self.0.iter_mut().flatten().map(|c| (c.field, c.scalar, &mut c.values))
    }

    /// The positions alone, in double precision.
    pub(crate) fn into_points(self) -> Vec<DVec3> {
        let [x, y, z, ..] = self.0.map(|column| column.map_or(Vec::new(), |c| c.values));
        let rows = x.into_iter().zip(y).zip(z);
        rows.map(|((x, y), z)| DVec3::new(x, y, z)).collect()
    }

    /// Makes a cloud of the columns, which must all have the same length.
    pub(crate) fn into_cloud(self, path: &Path) -> Result<Cloud> {
        let [x, y, z, intensity, ring, time] = self.0;
        let [x, y, z] = [x, y, z].map(|column| column.map_or(Vec::new(), |c| c.values));
        let points: Vec<_> = x
            .iter()
            .zip(&y)
            .zip(&z)
            .map(|((x, y), z)| Vec3::new(*x as f32, *y as f32, *z as f32))
            .collect();
        let rings = ring.map(|column| rings(path, &column.values)).transpose()?;
        Ok(Cloud {
            rings: rings.map(|mut rings| {
                tsdfuse::sensor::sort_rings(&points, &mut rings);
                rings
            }),
            secs: time.map(|column| secs(&column)),
            intensities: intensity.map(|column| column.values.iter().map(|v| *v as f32).collect()),
            points,
            viewpoint: None,
        })
    }
}

fn rings(path: &Path, values: &[f64]) -> Result<Vec<u16>> {
    let ring = |(i, v): (usize, &f64)| {
        let in_range = (0.0..=f64::from(u16::MAX)).contains(v) && v.fract() == 0.0;
        in_range
            .then_some(*v as u16)
            .ok_or_else(|| Error::format(path, format!("point {i}: {v} is no ring number")))
    };
    values.iter().enumerate().map(ring).collect()
}

fn secs(column: &Column) -> Vec<f64> {
    let values = column.values.iter();
    if column.scalar.is_integer() {
        return values.map(|t| t / 1e9).collect();
    }
    values.map(|t| epoch_secs(*t).unwrap_or(*t)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(fields: &[(&str, Scalar, f64)]) -> Result<Cloud, String> {
        let path = Path::new("a.pcd");
        let names: Vec<_> = fields.iter().map(|f| (f.0, f.1)).collect();
        let read = || {
            let mut columns = Columns::pick(path, &names)?;
            columns
                .each()
                .for_each(|(field, _, values)| values.push(fields[field].2));
            columns.into_cloud(path)
        };
        read().map_err(|e| e.to_string())
    }

    const XYZ: [(&str, Scalar, f64); 3] = [
        ("x", Scalar::F32, 1.0),
        ("Y", Scalar::F64, 2.0),
        ("z", Scalar::F32, 3.0),
    ];

    fn with(field: (&'static str, Scalar, f64)) -> Result<Cloud, String> {
        cloud(&[field, XYZ[2], XYZ[0], XYZ[1]])
    }

    #[test]
    fn fields_are_found_by_name_in_any_order() {
        let cloud = with(("scalar_Intensity", Scalar::F32, 7.0)).unwrap();
        assert_eq!(cloud.points, [Vec3::new(1.0, 2.0, 3.0)]);
        assert_eq!(
            (cloud.intensities, cloud.rings, cloud.secs),
            (Some(vec![7.0]), None, None)
        );
        let message = self::cloud(&XYZ[..2]).unwrap_err();
        assert_eq!(message, "a.pcd: has no field z");
    }

    #[test]
    fn rings_are_whole_numbers() {
        assert_eq!(with(("ring", Scalar::U16, 5.0)).unwrap().rings, Some(vec![5]));
        for bad in [-1.0, 65536.0, 0.5, f64::NAN] {
            let message = with(("ring", Scalar::F32, bad)).unwrap_err();
            assert_eq!(message, format!("a.pcd: point 0: {bad} is no ring number"));
        }
    }

    #[test]
    fn times_become_seconds() {
        for (scalar, value, secs) in [
            (Scalar::U32, 5e7, 0.05),
            (Scalar::F32, 0.05, 0.05),
            (Scalar::F64, 1.5e9, 1.5e9),
            (Scalar::F64, 1.5e18, 1.5e9),
            (Scalar::I64, 1.5e18, 1.5e9),
        ] {
            let read = with(("timestamp", scalar, value)).unwrap().secs.unwrap();
            assert!((read[0] - secs).abs() < 1e-6, "{value}: {read:?}");
        }
    }
}
