//! Depth images of RGB-D cameras: grey PNG files of 16 bits, and where the camera was.
//!
//! ```text
//! 7-Scenes                                          TUM RGB-D
//! frame-000000.depth.png   units of 1 mm            depth/1305031102.160407.png   units of 0.2 mm
//! frame-000000.pose.txt    4×4 world_from_optical   depth.txt                     time and file of each; or by the names
//! camera-intrinsics.txt    3×3; also a folder above groundtruth.txt               secs x y z qx qy qz qw
//! ```
//!
//! A pixel of 0 or 65535 measured nothing. Colour images are not read. Beside the images may lie
//!
//! - `camera.toml` (also in the folder above): `width`, `height`, `fx`, `fy`, `cx`, `cy` in pixels, and optionally `depth_scale`,
//!   metres per unit; goes before what the layout says,
//! - `mask.png`, for all frames, `mask/NAME.png` in the folder or `NAME.mask.png` beside the image NAME (`frame-000000`,
//!   `1305031102.160407`), for one: grey with 1 or 8 bits; pixels that are 0 in one of them are left out.
//!
//! Poses are of the optical frame (x right, y down, z forward), whatever file they come from; the world stays as it is.
//! Points are in the sensor frame (x forward, y left, z up), on the rays through the centres of their pixels.

use std::path::{Path, PathBuf};

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::scan::Dropped;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, Scan};

use crate::dataset::{OpenOptions, ScanRef, Source};
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::poses::{self, Poses};

pub(crate) mod camera;
pub(crate) mod image;
pub(crate) mod seven_scenes;
pub(crate) mod tum;

use image::ImageSize;

/// Nearer than any depth camera measures, metres.
const MIN_RANGE_M: f32 = 0.1;

/// A point (x, y, z) of the sensor frame is (−y, −z, x) in the optical one.
pub const OPTICAL_FROM_SENSOR: Pose = Pose {
    rotation: DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5),
    translation: DVec3::ZERO,
};

/// The file of a depth image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Image {
    file: ScanFile,
    /// The file's name without what says that it is a depth image.
    stem: String,
}

impl Image {
    /// The image of that name; `None` where its name ends otherwise, or is that of a mask.
    fn new(file: ScanFile, ending: &str) -> Option<Self> {
        let stem = file.name.strip_suffix(ending)?.to_owned();
        (!stem.ends_with(".mask")).then_some(Self { file, stem })
    }
}

/// What a layout tells.
struct Layout {
    format: &'static str,
    metres_per_unit: f32,
    frames: Vec<Frame>,
    /// The camera where there is no `camera.toml`.
    usual_camera: fn(&Path, &ImageSize, &mut Vec<String>) -> Result<Pinhole>,
    notes: Vec<String>,
}

/// A depth image and where it was taken.
struct Frame {
    image: Image,
    world_from_optical: Pose,
    secs: Option<f64>,
}

/// A folder of depth images.
pub(crate) struct DepthImages {
    format: &'static str,
    camera: Pinhole,
    metres_per_unit: f32,
    size: ImageSize,
    scans: Vec<ScanRef>,
    files: Vec<Files>,
    /// Which pixels count in all frames.
    mask: Option<Vec<bool>>,
    notes: Vec<String>,
}

/// The files of one frame.
struct Files {
    depths: PathBuf,
    masks: Vec<PathBuf>,
}

/// Whether there are depth images in one of the layouts.
pub(crate) fn recognises(path: &Path) -> bool {
    let any = |images: Result<Vec<Image>>| images.is_ok_and(|images| !images.is_empty());
    any(seven_scenes::images(path)) || any(tum::images(path))
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<DepthImages> {
    if let Some(name) = &options.sensor {
        let reason = format!("holds depth images: their camera is told by a camera.toml, not by the sensor {name:?}");
        return Err(Error::dataset(path, reason));
    }
    let images = seven_scenes::images(path)?;
    let layout = match images.is_empty() {
        false => seven_scenes::open(path, images, options)?,
        true => tum::open(path, tum::images(path)?, options)?,
    };
    DepthImages::new(path, layout)
}

impl DepthImages {
    fn new(root: &Path, layout: Layout) -> Result<Self> {
        let Layout {
            format,
            mut metres_per_unit,
            frames,
            usual_camera,
            mut notes,
        } = layout;
        let first = &frames
            .first()
            .ok_or_else(|| Error::dataset(root, "holds no depth images"))?
            .image
            .file
            .path;
        let mut size = ImageSize::read(first, &files::read(first)?)?;
        let camera = match beside_or_above(root, "camera.toml") {
            None => usual_camera(root, &size, &mut notes)?,
            Some(path) => {
                let (camera, scale) = camera::parse(&path, &files::read(&path)?)?;
                metres_per_unit = scale.unwrap_or(metres_per_unit);
                size = ImageSize {
                    width: camera.width,
                    height: camera.height,
                    by: "camera.toml".to_owned(),
                };
                camera
            }
        };
        let mask = root.join("mask.png");
        let mask = mask.is_file().then(|| image::mask(&mask, &files::read(&mask)?, &size));
        let files: Vec<_> = frames.iter().map(|frame| Files::of(root, &frame.image)).collect();
        let masked = files.iter().filter(|files| !files.masks.is_empty()).count();
        if (1..files.len()).contains(&masked) {
            notes.push(format!(
                "only {masked} of {} frames have a mask of their own",
                files.len()
            ));
        }
        Ok(Self {
            format,
            camera,
            metres_per_unit,
            size,
            scans: frames.into_iter().map(Frame::into_scan).collect(),
            files,
            mask: mask.transpose()?,
            notes,
        })
    }

    /// The points of a depth image, and how many of its pixels are none.
    fn back_project(&self, units: &[u16], mask: Option<&[bool]>) -> (Vec<tsdfuse::glam::Vec3>, Dropped) {
        let mut dropped = Dropped::default();
        let mut points = Vec::with_capacity(units.len());
        let shown = |pixel: usize| mask.is_none_or(|mask| mask.get(pixel) == Some(&true));
        let width = self.camera.width as usize;
        for (v, row) in units.chunks_exact(width).enumerate() {
            for (u, &units) in row.iter().enumerate() {
                match units {
                    _ if !shown(v * width + u) => dropped.masked += 1,
                    0 | u16::MAX => dropped.no_return += 1,
                    _ => points.push(self.camera.ray(u as f32, v as f32) * (f32::from(units) * self.metres_per_unit)),
                }
            }
        }
        (points, dropped)
    }
}

impl Source for DepthImages {
    fn format(&self) -> &'static str {
        self.format
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let (scan, files) = (&self.scans[index], &self.files[index]);
        let units = image::depths(&files.depths, &files::read(&files.depths)?, &self.size)?;
        let mut mask = self.mask.clone();
        for path in &files.masks {
            let own = image::mask(path, &files::read(path)?, &self.size)?;
            mask = Some(match mask {
                None => own,
                Some(mask) => mask.iter().zip(own).map(|(a, b)| *a && b).collect(),
            });
        }
        let (points, dropped) = self.back_project(&units, mask.as_deref());
        Ok(Scan {
            name: scan.name.clone(),
            time_ns: scan.timestamp_secs.map(|secs| tsdfuse::trajectory::ns_after(0, secs)),
            points,
            pose: Some(scan.pose),
            camera: Some(self.camera),
            dropped,
            ..Default::default()
        })
    }

    fn camera(&self) -> Option<Pinhole> {
        Some(self.camera)
    }

    fn min_range_m(&self) -> Option<f32> {
        Some(MIN_RANGE_M)
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Files {
    fn of(root: &Path, image: &Image) -> Self {
        let beside = image.file.path.with_file_name(format!("{}.mask.png", image.stem));
        let masks = [beside, root.join(format!("mask/{}.png", image.stem))];
        Self {
            depths: image.file.path.clone(),
            masks: masks.into_iter().filter(|mask| mask.is_file()).collect(),
        }
    }
}

impl Frame {
    fn into_scan(self) -> ScanRef {
        ScanRef {
            name: self.image.file.name,
            timestamp_secs: self.secs,
            pose: self.world_from_optical * OPTICAL_FROM_SENSOR,
        }
    }
}

/// Gives the images the poses of a file, as [`poses`] says; those at times for which a trajectory has none are left out.
fn placed(path: &Path, images: Vec<Image>, secs: Option<Vec<f64>>, notes: &mut Vec<String>) -> Result<Vec<Frame>> {
    let poses = poses::read(path)?;
    if let (Poses::Timed(trajectory), Some(secs)) = (&poses, &secs) {
        let found: Vec<_> = secs.iter().map(|&secs| (trajectory.at(secs), Some(secs))).collect();
        return with_pose(path, images, found, notes);
    }
    let files: Vec<_> = images.iter().map(|image| image.file.clone()).collect();
    let found = poses::place(path, &poses, &files, secs)?.into_iter();
    with_pose(
        path,
        images,
        found.map(|(pose, secs)| (Ok(pose), secs)).collect(),
        notes,
    )
}

/// The frames that have a pose (a time belongs to each); notes how many have none, and why the first of them has none.
fn with_pose(
    path: &Path,
    images: Vec<Image>,
    poses: Vec<(Result<Pose, String>, Option<f64>)>,
    notes: &mut Vec<String>,
) -> Result<Vec<Frame>> {
    let count = images.len();
    let (mut frames, mut first_reason) = (Vec::new(), None);
    for (image, (pose, secs)) in images.into_iter().zip(poses) {
        match pose {
            Ok(world_from_optical) => frames.push(Frame {
                image,
                world_from_optical,
                secs,
            }),
            Err(why) => {
                let at = secs.map_or(String::new(), |secs| format!(" at {secs:.6} s"));
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
fn beside_or_above(root: &Path, name: &str) -> Option<PathBuf> {
    [root.join(name), root.join("..").join(name)]
        .into_iter()
        .find(|path| path.is_file())
}

#[cfg(test)]
mod tests;
