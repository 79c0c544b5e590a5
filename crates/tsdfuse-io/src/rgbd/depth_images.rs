//! A folder of depth images as a source of scans.

use std::path::{Path, PathBuf};

use tsdfuse::scan::Dropped;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, Scan};

use super::image::{self, ImageSize};
use super::layout::{Frame, Image, Layout, beside_or_above};
use super::{camera, colors, seven_scenes, tum};
use crate::error::{Error, Result};
use crate::source::{ImageRef, OpenOptions, ScanRef, Sensor, Source};
use crate::{files, present};

/// Nearer than any depth camera measures, metres.
const MIN_RANGE_M: f32 = 0.1;

/// A folder of depth images.
pub(crate) struct DepthImages {
    format: &'static str,
    camera: Pinhole,
    sensors: [Sensor; 1],
    metres_per_unit: f32,
    size: ImageSize,
    scans: Vec<ScanRef>,
    files: Vec<Files>,
    /// Which pixels count in all frames.
    mask: Option<Vec<bool>>,
    images: Vec<ImageRef>,
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
    if let Some(name) = options.sensors.first() {
        let reason = format!("holds depth images: their camera is told by a camera.toml, not by the sensor {name:?}");
        return Err(Error::dataset(path, reason));
    }
    if options.extrinsics.is_some_and(|pose| pose != Pose::IDENTITY) {
        return Err(Error::dataset(
            path,
            "holds depth images, whose poses are the camera's own: no extrinsics are wanted",
        ));
    }
    let images = seven_scenes::images(path)?;
    let layout = if images.is_empty() {
        tum::open(path, tum::images(path)?, options)?
    } else {
        seven_scenes::open(path, images, options)?
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
        let camera = match beside_or_above(root, "camera.toml")? {
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
        let mask = present::file(&mask)?.then(|| image::mask(&mask, &files::read(&mask)?, &size));
        let files: Vec<_> = frames
            .iter()
            .map(|frame| Files::of(root, &frame.image))
            .collect::<Result<_>>()?;
        let masked = files.iter().filter(|files| !files.masks.is_empty()).count();
        if (1..files.len()).contains(&masked) {
            notes.push(format!(
                "only {masked} of {} frames have a mask of their own",
                files.len()
            ));
        }
        let images = colors::images(root, &frames, camera, &mut notes)?;
        Ok(Self {
            format,
            images,
            sensors: [Sensor {
                camera: Some(camera),
                min_range_m: Some(MIN_RANGE_M),
                ..Sensor::new("camera")
            }],
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
    fn format(&self) -> &str {
        self.format
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
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
            time_ns: scan.time_ns,
            points,
            pose: scan.pose,
            camera: Some(self.camera),
            dropped,
            ..Default::default()
        })
    }

    fn images(&self) -> &[ImageRef] {
        &self.images
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Files {
    fn of(root: &Path, image: &Image) -> Result<Self> {
        let beside = image.file.path.with_file_name(format!("{}.mask.png", image.stem));
        let masks = [beside, root.join(format!("mask/{}.png", image.stem))];
        let mut there = Vec::new();
        for mask in masks {
            if present::file(&mask)? {
                there.push(mask);
            }
        }
        Ok(Self {
            depths: image.file.path.clone(),
            masks: there,
        })
    }
}
