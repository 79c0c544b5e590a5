//! Where a camera's intrinsics come from.

use std::path::Path;

use serde::Deserialize;
use tsdfuse::sensor::Pinhole;

use super::image::ImageSize;
use crate::error::{Error, Result};
use crate::text;

/// `camera.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    width: u32,
    height: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    depth_scale: Option<f32>,
}

/// Parses `camera.toml`: the camera, and metres per unit of depth where it says so.
///
/// # Errors
/// Names the file, and the line or what no camera can have.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<(Pinhole, Option<f32>)> {
    let file: CameraFile = text::toml(path, bytes)?;
    let camera = Pinhole {
        width: file.width,
        height: file.height,
        fx: file.fx,
        fy: file.fy,
        cx: file.cx,
        cy: file.cy,
    };
    if let Some(scale) = file.depth_scale
        && !(scale > 0.0 && scale < 1.0)
    {
        let reason = format!("depth_scale = {scale}; it is metres per unit, between 0 and 1: 0.001 for millimetres");
        return Err(Error::format(path, reason));
    }
    Ok((checked(path, camera)?, file.depth_scale))
}

/// Parses `camera-intrinsics.txt`, the 3×3 matrix `fx 0 cx / 0 fy cy / 0 0 1`, for images of this size.
///
/// # Errors
/// Names the file, and the line or what no camera can have.
pub(crate) fn parse_matrix(path: &Path, bytes: &[u8], size: &ImageSize) -> Result<Pinhole> {
    let rows: Vec<Vec<f64>> = text::lines(path, bytes)?
        .map(|line| line.numbers())
        .collect::<Result<_>>()?;
    let numbers = rows.concat();
    match *numbers.as_slice() {
        [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0] if rows.len() == 3 => {
            checked(path, pinhole(size, [fx, fy, cx, cy].map(|v| v as f32)))
        }
        _ => Err(Error::format(path, "is not the 3x3 matrix fx 0 cx, 0 fy cy, 0 0 1")),
    }
}

/// The camera of these `fx fy cx cy`.
pub(super) fn pinhole(size: &ImageSize, [fx, fy, cx, cy]: [f32; 4]) -> Pinhole {
    Pinhole {
        width: size.width,
        height: size.height,
        fx,
        fy,
        cx,
        cy,
    }
}

/// The camera that such data sets are recorded with: its `fx fy cx cy` are those of images of 640 × 480.
pub(super) fn usual(root: &Path, size: &ImageSize, intrinsics: [f32; 4], missing: &str) -> Result<Pinhole> {
    let ImageSize { width, height, by } = size;
    match (width, height) {
        (640, 480) => Ok(pinhole(size, intrinsics)),
        _ => {
            let reason = format!("{missing}, and {by} is {width} x {height} pixels, not the usual 640 x 480");
            Err(Error::dataset(root, reason))
        }
    }
}

fn checked(path: &Path, camera: Pinhole) -> Result<Pinhole> {
    camera.check().map_err(|e| Error::format(path, e.to_string()))?;
    Ok(camera)
}
