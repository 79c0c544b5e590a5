//! From where a map is looked at, as it stands on the command line.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use glam::DVec3;
use tsdfuse::Pose;
use tsdfuse::sensor::Pinhole;
use tsdfuse_io::rgbd::OPTICAL_FROM_SENSOR;
use tsdfuse_run::eye::{Eye, rotation, towards};

use crate::args::parse_triple;
use crate::exit::Usage;

const SIZE: Size = Size {
    width: 1280,
    height: 720,
};
const FOV_DEG: f32 = 60.0;

/// From where, and through which camera.
#[derive(Debug, clap::Args)]
pub(super) struct LookArgs {
    /// Show what lies around the sensor's path from above (default).
    #[arg(long)]
    pub(super) overview: bool,
    /// Show it from N viewpoints around it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=9999))]
    pub(super) views: Option<u16>,
    /// Fly along the sensor's path.
    #[arg(long)]
    pub(super) along_path: bool,
    #[arg(
        help = "Render from this pose: X,Y,Z[,YAW[,PITCH[,ROLL]]], or a file with one pose",
        long,
        value_name = "POSE|FILE",
        allow_hyphen_values = true
    )]
    pub(super) pose: Option<String>,
    /// Render from each pose in a file.
    #[arg(long, value_name = "FILE")]
    pub(super) poses: Option<PathBuf>,
    /// Look from this place towards --to.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_triple, allow_hyphen_values = true, requires = "to")]
    pub(super) from: Option<DVec3>,
    /// The place that is looked at.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_triple, allow_hyphen_values = true, requires = "from")]
    pub(super) to: Option<DVec3>,
    /// Poses are given in the optical frame: x right, y down, z forward.
    #[arg(long, conflicts_with_all = ["overview", "views", "along_path", "from"])]
    pub(super) optical: bool,
    #[arg(long, value_name = "WIDTHxHEIGHT",
        help = format!("Pixels [default: {}x{}]", SIZE.width, SIZE.height))]
    pub(super) size: Option<Size>,
    #[arg(long, value_name = "DEG", help = format!("Horizontal field of view [default: {FOV_DEG}]"))]
    pub(super) fov: Option<f32>,
}

impl LookArgs {
    /// The pinhole camera.
    pub(super) fn camera(&self) -> Result<Pinhole> {
        pinhole(self.size.unwrap_or(SIZE), self.fov.unwrap_or(FOV_DEG))
    }
}

/// More pixels in a row than any screen has; bounds the memory of a view.
const MAX_EDGE: u32 = 8192;

/// From where a map is looked at, as the arguments say; pose files are read.
pub(super) fn eye(args: &LookArgs) -> Result<Eye> {
    if let Some(views) = args.views {
        return Ok(Eye::Around(views.into()));
    }
    if args.along_path {
        return Ok(Eye::Along);
    }
    if let (Some(from), Some(to)) = (args.from, args.to) {
        let pose = towards(from, to).ok_or_else(|| Usage::new("--from and --to are the same place"))?;
        return Ok(Eye::At(vec![pose]));
    }
    let mut poses = match (&args.pose, &args.poses) {
        (Some(text), _) => vec![pose(text)?],
        (_, Some(file)) => tsdfuse_io::poses::read_all(file)?,
        _ => return Ok(Eye::Overview),
    };
    if args.optical {
        poses.iter_mut().for_each(|pose| *pose = *pose * OPTICAL_FROM_SENSOR);
    }
    Ok(Eye::At(poses))
}

/// A pose in numbers, or in a file that holds one.
fn pose(text: &str) -> Result<Pose> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    if let Some(numbers) = numbers {
        let [x, y, z, angles_deg @ ..] = numbers.as_slice() else {
            return Err(wrong_pose(text).into());
        };
        if angles_deg.len() > 3 || !numbers.iter().all(|n| n.is_finite()) {
            return Err(wrong_pose(text).into());
        }
        let angle = |i: usize| angles_deg.get(i).copied().unwrap_or(0.0).to_radians();
        return Ok(Pose {
            rotation: rotation(angle(0), angle(1), angle(2)),
            translation: DVec3::new(*x, *y, *z),
        });
    }
    if !Path::new(text).exists() {
        return Err(wrong_pose(text).into());
    }
    let poses = tsdfuse_io::poses::read_all(text)?;
    match poses.as_slice() {
        [pose] => Ok(*pose),
        poses => Err(Usage::new(format_args!(
            "{text}: holds {} poses; --poses renders them all",
            poses.len()
        ))
        .into()),
    }
}

fn wrong_pose(text: &str) -> Usage {
    Usage::new(format_args!(
        "--pose {text}: neither X,Y,Z[,YAW[,PITCH[,ROLL]]] in metres and degrees nor a file"
    ))
}

/// The size of a picture: `640x480`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Size {
    pub(super) width: u32,
    pub(super) height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let edge = |text: &str| text.trim().parse().ok().filter(|n| (1..=MAX_EDGE).contains(n));
        let both = text
            .split_once(['x', 'X'])
            .and_then(|(w, h)| Some((edge(w)?, edge(h)?)));
        let (width, height) =
            both.ok_or_else(|| format!("WIDTHxHEIGHT is wanted, as in 640x480, each from 1 to {MAX_EDGE} pixels"))?;
        Ok(Self { width, height })
    }
}

/// A camera with this field of view across.
fn pinhole(size: Size, fov_deg: f32) -> Result<Pinhole> {
    if !(1.0..=170.0).contains(&fov_deg) {
        return Err(Usage::new(format_args!("--fov must be from 1 to 170 degrees, not {fov_deg}")).into());
    }
    let camera = Pinhole::with_fov(size.width, size.height, fov_deg.to_radians());
    camera.check().context("the camera")?;
    Ok(camera)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_turn_left_up_and_the_right_side_down() {
        let axes = |text: &str| {
            let pose = pose(text).unwrap();
            assert_eq!(pose.translation, DVec3::new(1.0, -2.0, 3.5));
            [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (pose.rotation * axis * 1e6).round() / 1e6)
        };
        assert_eq!(axes("1,-2,3.5"), [DVec3::X, DVec3::Y, DVec3::Z]);
        assert_eq!(axes("1, -2, 3.5, 90"), [DVec3::Y, -DVec3::X, DVec3::Z]);
        assert_eq!(axes("1,-2,3.5,0,90"), [DVec3::Z, DVec3::Y, -DVec3::X]);
        assert_eq!(axes("1,-2,3.5,0,0,90"), [DVec3::X, DVec3::Z, -DVec3::Y]);
    }

    #[test]
    fn sizes_are_two_numbers() {
        assert_eq!(
            "640x480".parse(),
            Ok(Size {
                width: 640,
                height: 480
            })
        );
        for bad in ["", "640", "640x", "0x5", "9000x9000", "-1x5", "640x480x3"] {
            assert!(bad.parse::<Size>().unwrap_err().contains("as in 640x480"), "{bad}");
        }
    }
}
