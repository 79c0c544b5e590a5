//! Poses as a table with named columns: CSV files of many programs and data sets.
//!
//! | column | names |
//! |---|---|
//! | time | `time`, `timestamp`, `t`, `stamp`, `utime`; or `sec` and `nsec` |
//! | position | `x` `y` `z`, also `tx`, `px`, `p_x`, `pos_x`, `position.x`, `p_RS_R_x [m]`, … |
//! | orientation | `qx` `qy` `qz` `qw`, also `q_x`, `orientation.x`, `q_RS_x []`, …; or `roll` `pitch` `yaw` (radians, or degrees if `deg` is in the name) |
//!
//! And as inertial navigation systems write them:
//!
//! | column | names |
//! |---|---|
//! | time | also `GPSTime`, `gps_seconds` |
//! | position | `latitude` `longitude` (degrees) `altitude` or `height` (metres above the ellipsoid); or `easting` `northing` `height` (metres) |
//! | orientation | `roll` `pitch` `heading` (or `azimuth`); degrees, unless `rad` is in a name: right side down, nose up, clockwise from north |
//!
//! The body then has x forward, y left and z up, and the world x east, y north and z up; of latitudes and longitudes, the first one is
//! its origin. Other columns are passed over.

use std::path::Path;

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::{Pose, Trajectory};

use super::Poses;
use crate::error::{Error, Result};
use crate::geodesy::{Geographic, attitude};
use crate::text::{self, Line};

/// Words for rates, accelerations and the like, whose x, y and z are no position.
const OTHERS: [&str; 20] = [
    "v",
    "vx",
    "vy",
    "vz",
    "vel",
    "velocity",
    "twist",
    "linear",
    "angular",
    "a",
    "acc",
    "accel",
    "acceleration",
    "b",
    "w",
    "gyro",
    "cov",
    "covariance",
    "std",
    "gravity",
];
const QUATERNION: [&str; 5] = ["q", "quat", "quaternion", "orientation", "rotation"];
const TIME: [&str; 10] = [
    "gpstime",
    "time",
    "timestamp",
    "timestamps",
    "t",
    "stamp",
    "utime",
    "sec",
    "secs",
    "seconds",
];
const LATITUDE: [&str; 2] = ["latitude", "lat"];
const LONGITUDE: [&str; 4] = ["longitude", "lon", "long", "lng"];
const HEIGHT: [&str; 6] = ["altitude", "alt", "height", "hgt", "h", "up"];
const EASTING: [&str; 2] = ["easting", "east"];
const NORTHING: [&str; 2] = ["northing", "north"];
const HEADING: [&str; 2] = ["heading", "azimuth"];
const NANOSECONDS: [&str; 4] = ["nsec", "nsecs", "nanosec", "nanoseconds"];

/// Where the columns of a table are.
#[derive(Debug)]
pub(super) struct Header {
    separator: char,
    time: Option<usize>,
    nanoseconds: Option<usize>,
    position: [usize; 3],
    /// Whether the position is latitude, longitude and height.
    is_geographic: bool,
    rotation: Rotation,
}

#[derive(Debug)]
enum Rotation {
    Quaternion([usize; 4]),
    /// Roll, pitch, yaw, and what a unit of theirs is in radians.
    Angles([usize; 3], f64),
    /// Roll, pitch and heading of an inertial navigation system, and their unit.
    Heading([usize; 3], f64),
}

impl Header {
    /// The header, if the first line of the file is one that names the columns of poses.
    pub(super) fn find(bytes: &[u8]) -> Option<Self> {
        let end = bytes
            .iter()
            .take(1 << 16)
            .position(|b| *b == b'\n')
            .unwrap_or(bytes.len());
        let line = std::str::from_utf8(bytes.get(..end)?).ok()?;
        let line = line.trim_start_matches(['\u{feff}', '#', '%', ' ']).trim();
        let separator = [',', ';', '\t']
            .into_iter()
            .find(|&separator| line.contains(separator))?;
        let names: Vec<Vec<String>> = line.split(separator).map(words).collect();
        let first = |is: &dyn Fn(&[String]) -> bool| names.iter().position(|name| is(name));
        let ends = |name: &[String], all: &[&str]| name.last().is_some_and(|last| all.contains(&last.as_str()));
        let has = |name: &[String], all: &[&str]| name.iter().any(|word| all.contains(&word.as_str()));
        let axis = |axis: &'static str, of_rotation: bool| {
            first(&|name| {
                let Some((last, before)) = name.split_last() else {
                    return false;
                };
                let joined = |letters: &[&str]| letters.iter().any(|letter| *last == format!("{letter}{axis}"));
                if of_rotation {
                    joined(&["q"]) || (last == axis && has(before, &QUATERNION))
                } else {
                    let is_other = has(before, &OTHERS) || has(before, &QUATERNION);
                    !is_other && (last == axis || joined(&["t", "p"]))
                }
            })
        };
        let all = |axes: &[&'static str], of_rotation| {
            let found = axes.iter().map(|name| axis(name, of_rotation));
            found.collect::<Option<Vec<usize>>>()
        };
        let angle =
            |long: &str| first(&|name| ends(name, &[long]) || has(name, &[long]) && ends(name, &["deg", "rad"]));
        let angles = || {
            Some([
                angle("roll")?,
                angle("pitch")?,
                angle("yaw").or_else(|| angle("heading"))?,
            ])
        };
        let named = |all: &[&str]| {
            first(&|name: &[String]| {
                let name = match name {
                    [before @ .., unit] if !before.is_empty() && ["deg", "rad"].contains(&unit.as_str()) => before,
                    name => name,
                };
                ends(name, all) && !has(name, &OTHERS)
            })
        };
        let of_ins = |across: &[&str], along: &[&str]| Some([named(across)?, named(along)?, named(&HEIGHT)?]);
        let geographic = of_ins(&LATITUDE, &LONGITUDE);
        let surveyed = geographic.or_else(|| of_ins(&EASTING, &NORTHING));
        let heading = || Some([named(&["roll"])?, named(&["pitch"])?, named(&HEADING)?]);
        let rotation = match (all(&["x", "y", "z", "w"], true), surveyed.and_then(|_| heading())) {
            (Some(found), _) => Rotation::Quaternion(found.try_into().ok()?),
            (None, Some(angles)) => {
                let is_radians = |&column: &usize| {
                    let name = line.split(separator).nth(column).unwrap_or_default();
                    name.to_ascii_lowercase().contains("rad")
                };
                let is_radians = angles.iter().any(is_radians);
                Rotation::Heading(angles, if is_radians { 1.0 } else { 1f64.to_radians() })
            }
            (None, None) => {
                let angles = angles()?;
                let is_degrees = line.to_ascii_lowercase().contains("deg");
                Rotation::Angles(angles, if is_degrees { 1f64.to_radians() } else { 1.0 })
            }
        };
        Some(Self {
            separator,
            time: first(&|name| ends(name, &TIME)),
            nanoseconds: first(&|name| ends(name, &NANOSECONDS)),
            position: match surveyed {
                Some(position) => position,
                None => all(&["x", "y", "z"], false)?.try_into().ok()?,
            },
            is_geographic: geographic.is_some(),
            rotation,
        })
    }

    /// Reads the lines after the header.
    pub(super) fn parse(&self, path: &Path, bytes: &[u8]) -> Result<Poses> {
        let (mut timed, mut listed): (Vec<(i64, Pose)>, Vec<Pose>) = (Vec::new(), Vec::new());
        let mut origin = None;
        // A header that is a comment is no line.
        let lines = text::lines(path, bytes)?.skip_while(|line| line.number == 1);
        for line in lines {
            let cells: Vec<&str> = line.text.split(self.separator).map(str::trim).collect();
            let pose = self.pose(&line, &cells, &mut origin)?;
            match self.time_ns(&line, &cells)? {
                Some(time_ns) => {
                    if timed.last().is_some_and(|&(last, _)| last >= time_ns) {
                        return Err(line.error("its time is not later than that of the pose before"));
                    }
                    timed.push((time_ns, pose));
                }
                None => listed.push(pose),
            }
        }
        match (timed.is_empty(), listed.is_empty()) {
            (true, true) => Err(Error::format(path, "holds no poses")),
            (true, false) => Ok(Poses::Listed(listed)),
            _ => Trajectory::new(timed)
                .map(Poses::Timed)
                .map_err(|e| Error::format(path, e.to_string())),
        }
    }

    fn time_ns(&self, line: &Line, cells: &[&str]) -> Result<Option<i64>> {
        let Some(column) = self.time else { return Ok(None) };
        let cell = |column: usize| cells.get(column).copied().unwrap_or_default();
        let wrong = |cell: &str| line.error(format!("{cell:?} is no time"));
        let time_ns = text::nanoseconds(cell(column)).ok_or_else(|| wrong(cell(column)))?;
        let Some(rest) = self.nanoseconds else {
            return Ok(Some(time_ns));
        };
        let rest: i64 = cell(rest).parse().map_err(|_| wrong(cell(rest)))?;
        time_ns.checked_add(rest).map(Some).ok_or_else(|| wrong(cell(column)))
    }

    /// The pose of a line; `origin` is where the first one was, on the earth.
    fn pose(&self, line: &Line, cells: &[&str], origin: &mut Option<Geographic>) -> Result<Pose> {
        let number = |column: usize| {
            let cell = cells.get(column).copied();
            let cell = cell.ok_or_else(|| line.error(format!("has {} columns, fewer than the header", cells.len())))?;
            cell.parse::<f64>()
                .map_err(|_| line.error(format!("{cell:?} is not a number")))
        };
        let [x, y, z] = self.position;
        let position = DVec3::new(number(x)?, number(y)?, number(z)?);
        let rotation = match self.rotation {
            Rotation::Quaternion([x, y, z, w]) => DQuat::from_xyzw(number(x)?, number(y)?, number(z)?, number(w)?),
            Rotation::Angles([roll, pitch, yaw], unit) => {
                let [roll, pitch, yaw] = [number(roll)? * unit, number(pitch)? * unit, number(yaw)? * unit];
                DQuat::from_rotation_z(yaw) * DQuat::from_rotation_y(pitch) * DQuat::from_rotation_x(roll)
            }
            Rotation::Heading([roll, pitch, heading], unit) => {
                attitude([number(roll)? * unit, number(pitch)? * unit, number(heading)? * unit])
            }
        };
        let pose = Pose::new(rotation, position).map_err(|e| line.error(e))?;
        if !self.is_geographic {
            return Ok(pose);
        }
        let here = Geographic {
            latitude_deg: position.x,
            longitude_deg: position.y,
            height_m: position.z,
        };
        here.body(pose.rotation, origin).map_err(|why| line.error(why))
    }
}

/// The words of a column's name in lower case, without its unit.
fn words(name: &str) -> Vec<String> {
    let name = name.split(['[', '(']).next().unwrap_or_default();
    let words = name
        .split(|c: char| !c.is_ascii_alphanumeric())
        .filter(|word| !word.is_empty());
    let mut words: Vec<String> = words.map(str::to_ascii_lowercase).collect();
    if words.len() > 1
        && words
            .last()
            .is_some_and(|last| ["m", "s", "ns"].contains(&last.as_str()))
    {
        words.pop();
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<(i64, Pose)>, String> {
        let poses = super::super::parse(Path::new("a.csv"), text.as_bytes()).map_err(|e| e.to_string())?;
        Ok(match poses {
            Poses::Timed(t) => t.times_ns().iter().copied().zip(t.poses().iter().copied()).collect(),
            Poses::Listed(poses) => poses.into_iter().map(|pose| (-1, pose)).collect(),
        })
    }

    #[test]
    fn columns_are_found_by_their_usual_names() {
        let turned = DQuat::from_xyzw(0.0, 0.0, 0.6, 0.8);
        for text in [
            "timestamp,tx,ty,tz,qx,qy,qz,qw\n1.5,1,2,3,0,0,0.6,0.8\n",
            "#sec,nsec,x,y,z,qx,qy,qz,qw\n1,500000000,1,2,3,0,0,0.6,0.8\n",
            "# timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1]\n\
             1.5,1,2,3,0.8,0,0,0.6,9,9\n",
            "%time,field.header.seq,field.twist.linear.x,field.pose.position.x,field.pose.position.y,field.pose.position.z,\
             field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w\r\n1.5,7,9,1,2,3,0,0,0.6,0.8\r\n",
            "t;tx_m;ty_m;tz_m;qw;qx;qy;qz\n1.5;1;2;3;0.8;0;0;0.6\n",
            "time (s),x (m),y (m),z (m),roll,pitch,yaw [deg]\n1.5,1,2,3,0,0,73.739795292\n",
        ] {
            let poses = read(text).unwrap();
            let [(time_ns, pose)] = poses.as_slice() else {
                panic!("{text}: {poses:?}")
            };
            assert_eq!(
                (*time_ns, pose.translation),
                (1_500_000_000, DVec3::new(1.0, 2.0, 3.0)),
                "{text}"
            );
            assert!(pose.rotation.angle_between(turned) < 1e-9, "{text}: {pose:?}");
        }
        let listed = read("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n0,0,0,0,0,0,1\n").unwrap();
        assert_eq!((listed.len(), listed[0].0), (2, -1));
    }

    #[test]
    fn inertial_navigation_systems_tell_places_on_the_earth() {
        for head in [
            "GPSTime (s), Latitude (deg), Longitude (deg), Height (m), Roll (deg), Pitch (deg), Heading (deg), std_lat",
            "time,lat,lon,alt,roll_deg,pitch_deg,heading_deg,vel_east",
        ] {
            // A metre is 9e-6° along a meridian.
            let text =
                format!("{head}\n10.5,49,8,110,0,0,90,7\n10.6,49.0000089914,8,111,10,0,0,7\n10.7,49,8,110,0,5,0,7\n");
            let poses = read(&text).unwrap();
            assert_eq!((poses.len(), poses[1].0), (3, 10_600_000_000), "{head}");
            let at = |i: usize, v: DVec3| poses[i].1.rotation * v;
            assert!(poses[0].1.translation.length() < 1e-9);
            // Heading east, x looks east and y north.
            assert!(at(0, DVec3::X).distance(DVec3::X) < 1e-9 && at(0, DVec3::Y).distance(DVec3::Y) < 1e-9);
            // One metre north and one up; heading north, rolled by 10°: the left side is up, and lies in the west.
            assert!(
                poses[1].1.translation.distance(DVec3::new(0.0, 1.0, 1.0)) < 1e-4,
                "{:?}",
                poses[1].1
            );
            assert!(at(1, DVec3::X).distance(DVec3::Y) < 1e-6);
            let left = DVec3::new(-10f64.to_radians().cos(), 0.0, 10f64.to_radians().sin());
            assert!(at(1, DVec3::Y).distance(left) < 1e-6, "{}", at(1, DVec3::Y));
            // The nose up by 5°.
            assert!((at(2, DVec3::X).z - 5f64.to_radians().sin()).abs() < 1e-9);
        }
        let text = "t,easting,northing,height,roll[rad],pitch[rad],azimuth[rad]\n1,690000,5330000,500,0,0,1.5707963267948966\n";
        let poses = read(text).unwrap();
        assert_eq!(poses[0].1.translation, DVec3::new(690_000.0, 5_330_000.0, 500.0));
        assert!((poses[0].1.rotation * DVec3::X).distance(DVec3::X) < 1e-9);
        let told = read("t,lat,lon,alt,roll,pitch,heading\n1,91,0,0,0,0,0\n").unwrap_err();
        assert!(told.contains("line 2: no place on the earth"), "{told}");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let head = "t,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n";
        for (line, wanted) in [
            ("1,2,3", "line 3: has 3 columns, fewer than the header"),
            ("1,a,0,0,0,0,0,1", "line 3: \"a\" is not a number"),
            ("x,0,0,0,0,0,0,1", "line 3: \"x\" is no time"),
            (
                "0,0,0,0,0,0,0,1",
                "line 3: its time is not later than that of the pose before",
            ),
            ("1,0,0,0,0,0,0,0", "line 3: "),
            ("1,nan,0,0,0,0,0,1", "line 3: "),
        ] {
            let message = read(&format!("{head}{line}\n")).unwrap_err();
            assert!(message.starts_with("a.csv: ") && message.contains(wanted), "{message}");
        }
        assert_eq!(read("t,x,y,z,qx,qy,qz,qw\n").unwrap_err(), "a.csv: holds no poses");
        // No header of poses.
        assert!(read("t,speed\n1,2\n").unwrap_err().contains("is not a number"));
    }
}
