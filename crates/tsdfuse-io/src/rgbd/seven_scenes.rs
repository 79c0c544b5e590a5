//! The layout of 7-Scenes: `frame-000000.depth.png` with `frame-000000.pose.txt`.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::sensor::Pinhole;

use super::camera;
use super::image::ImageSize;
use super::layout::{Image, Layout, beside_or_above, placed, with_pose, without_poses};
use crate::error::{Error, Result};
use crate::source::OpenOptions;
use crate::{files, present, text};

/// Millimetres.
const METRES_PER_UNIT: f32 = 1e-3;

/// What 7-Scenes is evaluated with: `fx fy cx cy` of its Kinect.
const INTRINSICS: [f32; 4] = [585.0, 585.0, 320.0, 240.0];

/// The depth images in the folder.
pub(super) fn images(root: &Path) -> Result<Vec<Image>> {
    let images = files::list(root, "png")?.into_iter();
    let images = images.filter_map(|file| Image::new(file, ".depth.png"));
    Ok(images.collect())
}

pub(super) fn open(root: &Path, images: Vec<Image>, options: &OpenOptions) -> Result<Layout> {
    let mut notes = Vec::new();
    let frames = match &options.poses {
        Some(path) => placed(path, images, None, &mut notes)?,
        None if none_has_a_pose(root, &images)? => without_poses(images, None, &mut notes),
        None => {
            let poses = images.iter().map(|image| {
                let lost = "its matrix holds numbers that are not finite, so the camera's tracking was lost";
                Ok((pose(root, image)?.ok_or_else(|| lost.to_owned()), None))
            });
            let poses = poses.collect::<Result<_>>()?;
            with_pose(root, images, poses, &mut notes)?
        }
    };
    Ok(Layout {
        format: "7-Scenes",
        metres_per_unit: METRES_PER_UNIT,
        frames,
        usual_camera,
        notes,
    })
}

/// Whether no image has a file with its pose.
fn none_has_a_pose(root: &Path, images: &[Image]) -> Result<bool> {
    for image in images {
        if present::file(&root.join(format!("{}.pose.txt", image.stem)))? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// `world_from_optical` of an image; `None` where tracking was lost.
fn pose(root: &Path, image: &Image) -> Result<Option<Pose>> {
    let path = root.join(format!("{}.pose.txt", image.stem));
    if present::file(&path)? {
        return parse_pose(&path, &files::read(&path)?);
    }
    let reason = format!("has no pose: there is no {}.pose.txt beside it", image.stem);
    Err(Error::dataset(&image.file.path, reason))
}

/// Parses a `.pose.txt`, the 4×4 matrix `world_from_optical`; `None` where a number in it is not finite, which is how
/// recorders write that tracking was lost.
///
/// # Errors
/// Names the file, and the line or what is no pose about it.
pub(crate) fn parse_pose(path: &Path, bytes: &[u8]) -> Result<Option<Pose>> {
    let mut rows = Vec::new();
    for line in text::lines(path, bytes)? {
        let numbers = line.numbers()?;
        if numbers.len() != 4 || rows.len() == 16 {
            return Err(line.error("a pose has 4 lines of 4 numbers"));
        }
        rows.extend(numbers);
    }
    let Some((matrix, [0.0, 0.0, 0.0, 1.0])) = rows.split_first_chunk::<12>() else {
        let lost = rows.len() == 16 && rows.iter().any(|v| !v.is_finite());
        if lost {
            return Ok(None);
        }
        return Err(Error::format(path, "is not a 4x4 matrix that ends in 0 0 0 1"));
    };
    if matrix.iter().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    let pose = Pose::from_row_major_3x4(matrix);
    pose.map(Some).map_err(|e| Error::format(path, e.to_string()))
}

fn usual_camera(root: &Path, size: &ImageSize, notes: &mut Vec<String>) -> Result<Pinhole> {
    if let Some(path) = beside_or_above(root, "camera-intrinsics.txt")? {
        return camera::parse_matrix(&path, &files::read(&path)?, size);
    }
    let missing = "no camera-intrinsics.txt or camera.toml";
    notes.push(format!("{missing}: the camera is taken to be that of 7-Scenes"));
    camera::usual(root, size, INTRINSICS, missing)
}
