//! KITTI's `calib.txt`: how the camera, whose poses KITTI gives, sits relative to the laser scanner.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::glam::DVec3;
use tsdfuse::sensor::Pinhole;

use crate::error::{Error, Result};
use crate::text::{self, Line};
use crate::{files, poses, present};

/// The points of KITTI's HDL-64E lie this much too low, degrees (Deschaud, IMLS-SLAM, ICRA 2018, section IV-B).
pub(crate) const KITTI_HDL64E_DEG: f64 = 0.205;

/// `camera_from_velodyne`, if the folder has a `calib.txt` with a line `Tr`.
pub(crate) fn in_folder(folder: &Path) -> Result<Option<Pose>> {
    let path = folder.join("calib.txt");
    if !present::file(&path)? {
        return Ok(None);
    }
    parse(&path, &files::read(&path)?, "Tr")
}

/// Parses the transform of the line `name: 12 numbers`, if there is that line; `path` is for messages.
///
/// # Errors
/// Names the file, the line and what is wrong with the numbers.
pub(crate) fn parse(path: &Path, bytes: &[u8], name: &str) -> Result<Option<Pose>> {
    let line = entry(path, bytes, name)?;
    line.map(|line| poses::matrix(&line, &line.numbers()?)).transpose()
}

/// The camera of the line `name: 12 numbers`, the projection of a rectified image, if there is that line: its intrinsics but for the size, and
/// the place of the camera in the frame that is projected.
pub(crate) fn projection(folder: &Path, name: &str) -> Result<Option<(Pinhole, Pose)>> {
    let path = folder.join("calib.txt");
    let bytes = files::read(&path)?;
    let Some(line) = entry(&path, &bytes, name)? else {
        return Ok(None);
    };
    let numbers = line.numbers()?;
    let &[fx, _, cx, px, _, fy, cy, py, _, _, _, pz] = numbers.as_slice() else {
        return Err(line.error(format!("{} numbers where a projection has 12", numbers.len())));
    };
    if !(fx > 0.0 && fy > 0.0 && numbers.iter().all(|v| v.is_finite() && v.abs() < 1e6)) {
        return Err(line.error("is no projection of a camera"));
    }
    let translation = -DVec3::new((px - cx * pz) / fx, (py - cy * pz) / fy, pz);
    let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v as f32);
    let camera = Pinhole {
        width: 1,
        height: 1,
        fx,
        fy,
        cx,
        cy,
    };
    let place = Pose {
        translation,
        ..Pose::IDENTITY
    };
    Ok(Some((camera, place)))
}

/// Parses the transform of the lines `R:` and `T:`, as in `calib_imu_to_velo.txt`; `path` is for messages.
///
/// # Errors
/// Names the file, and the line or what is wrong with the numbers.
pub(crate) fn parse_rt(path: &Path, bytes: &[u8]) -> Result<Pose> {
    let (Some(rotation), Some(translation)) = (entry(path, bytes, "R")?, entry(path, bytes, "T")?) else {
        return Err(Error::format(path, "has no lines R and T"));
    };
    let (&[a, b, c, d, e, f, g, h, i], &[x, y, z]) = (&*rotation.numbers()?, &*translation.numbers()?) else {
        return Err(rotation.error("R has 9 numbers and T has 3"));
    };
    poses::matrix(&rotation, &[a, b, c, x, d, e, f, y, g, h, i, z])
}

/// What follows `name:`.
fn entry<'a>(path: &'a Path, bytes: &'a [u8], name: &str) -> Result<Option<Line<'a>>> {
    Ok(text::lines(path, bytes)?.find_map(|line| {
        let text = line.text.strip_prefix(name)?.strip_prefix(':')?;
        Some(Line { text, ..line })
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_is_found_and_its_numbers_are_checked() {
        let of = |text: &str| parse(Path::new("calib.txt"), text.as_bytes(), "Tr").map_err(|e| e.to_string());
        let tr = "Tr: 0 -1 0 1 0 0 -1 2 1 0 0 3";
        let pose = of(&format!("P0: 1 2 3\nTrx: 7\n{tr}\n")).unwrap().unwrap();
        assert_eq!(pose.translation.to_array(), [1.0, 2.0, 3.0]);
        assert_eq!(of("P0: 1 2 3\n"), Ok(None));
        assert_eq!(
            of("P0: 1\nTr: 1 2 3\n").unwrap_err(),
            "calib.txt: line 2: 3 numbers where a pose has 12"
        );
        assert!(
            of("Tr: 9 0 0 0 0 9 0 0 0 0 9 0")
                .unwrap_err()
                .contains("line 1: the pose is not rigid")
        );
    }
}
