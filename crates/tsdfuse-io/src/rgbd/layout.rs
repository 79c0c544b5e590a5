//! What the layouts of folders with depth images share: images, and the poses they were taken from.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::sensor::Pinhole;
use tsdfuse::trajectory::secs_between;

use super::image::ImageSize;
use crate::error::{Error, Result};
use crate::files::ScanFile;
use crate::poses::{self, Poses};
use crate::present;
use crate::source::ScanRef;

/// A point (x, y, z) of the sensor frame is (−y, −z, x) in the optical one.
pub const OPTICAL_FROM_SENSOR: Pose = Pose {
    rotation: DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5),
    translation: DVec3::ZERO,
};

/// The file of a depth image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Image {
    pub(super) file: ScanFile,
    /// The file's name without what says that it is a depth image.
    pub(super) stem: String,
}

impl Image {
    /// The image of that name; `None` where its name ends otherwise, or is that of a mask.
    pub(super) fn new(file: ScanFile, ending: &str) -> Option<Self> {
        let stem = file.name.strip_suffix(ending)?.to_owned();
        (!stem.ends_with(".mask")).then_some(Self { file, stem })
    }
}

/// What a layout tells.
pub(super) struct Layout {
    pub(super) format: &'static str,
    pub(super) metres_per_unit: f32,
    pub(super) frames: Vec<Frame>,
    /// The camera where there is no `camera.toml`.
    pub(super) usual_camera: fn(&Path, &ImageSize, &mut Vec<String>) -> Result<Pinhole>,
    pub(super) notes: Vec<String>,
}

/// A depth image and where it was taken.
pub(super) struct Frame {
    pub(super) image: Image,
    pub(super) world_from_optical: Option<Pose>,
    pub(super) time_ns: Option<i64>,
}

impl Frame {
    pub(super) fn into_scan(self) -> ScanRef {
        ScanRef {
            name: self.image.file.name,
            sensor: 0,
            time_ns: self.time_ns,
            pose: self.world_from_optical.map(|pose| pose * OPTICAL_FROM_SENSOR),
        }
    }
}

/// The images at their times, without poses.
pub(super) fn without_poses(images: Vec<Image>, times_ns: Option<Vec<i64>>, notes: &mut Vec<String>) -> Vec<Frame> {
    notes.push("there are no poses: where the camera was is not known".to_owned());
    let times_ns = times_ns.into_iter().flatten().map(Some).chain(std::iter::repeat(None));
    let frames = images.into_iter().zip(times_ns).map(|(image, time_ns)| Frame {
        image,
        world_from_optical: None,
        time_ns,
    });
    frames.collect()
}

/// Gives the images the poses of a file, as [`poses`] says; those at times for which a trajectory has none are left out.
pub(super) fn placed(
    path: &Path,
    images: Vec<Image>,
    times_ns: Option<Vec<i64>>,
    notes: &mut Vec<String>,
) -> Result<Vec<Frame>> {
    let poses = poses::read(path)?;
    if let (Poses::Timed(trajectory), Some(times_ns)) = (&poses, &times_ns) {
        let found: Vec<_> = times_ns.iter().map(|&t| (poses::at(trajectory, t), Some(t))).collect();
        return with_pose(path, images, found, notes);
    }
    let files: Vec<_> = images.iter().map(|image| image.file.clone()).collect();
    let found = poses::place(path, &poses, &files, times_ns)?.into_iter();
    with_pose(
        path,
        images,
        found.map(|(pose, time_ns)| (Ok(pose), time_ns)).collect(),
        notes,
    )
}

/// The frames that have a pose (a time belongs to each); notes how many have none, and why the first of them has none.
pub(super) fn with_pose(
    path: &Path,
    images: Vec<Image>,
    poses: Vec<(Result<Pose, String>, Option<i64>)>,
    notes: &mut Vec<String>,
) -> Result<Vec<Frame>> {
    let count = images.len();
    let (mut frames, mut first_reason) = (Vec::new(), None);
    for (image, (pose, time_ns)) in images.into_iter().zip(poses) {
        match pose {
            Ok(world_from_optical) => frames.push(Frame {
                image,
                world_from_optical: Some(world_from_optical),
                time_ns,
            }),
            Err(why) => {
                let at = time_ns.map_or(String::new(), |t| format!(" at {:.6} s", secs_between(0, t)));
                first_reason.get_or_insert(format!("no pose for {}{at}: {why}", image.file.name));
            }
        }
    }
    match first_reason {
        Some(reason) if frames.is_empty() => return Err(Error::dataset(path, reason)),
        Some(reason) => notes.push(format!(
            "{} of {count} frames are left out: {reason}",
            count - frames.len()
        )),
        None => {}
    }
    Ok(frames)
}

/// The file in the folder or the one above.
pub(super) fn beside_or_above(root: &Path, name: &str) -> Result<Option<PathBuf>> {
    for path in [root.join(name), root.join("..").join(name)] {
        if present::file(&path)? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}
