//! The colour images beside depth images: `frame-000000.color.png` of 7-Scenes, and `rgb/*.png` of TUM RGB-D.
//!
//! In both, they are registered to the depth images (TUM) or nearly so (7-Scenes), so their camera is the same.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;
use tsdfuse::sensor::Pinhole;
use tsdfuse::trajectory::{ns_after, secs_between};

use super::image::ImageSize;
use super::layout::Frame;
use crate::error::Result;
use crate::source::ImageRef;
use crate::{files, present, text};

/// Between depth images that are farther apart than this, a pose is not interpolated, seconds.
const MOST_SECS: f64 = 0.2;

/// The colour images whose poses are known; says in a note why there are none where there are files.
pub(super) fn images(root: &Path, frames: &[Frame], camera: Pinhole, notes: &mut Vec<String>) -> Result<Vec<ImageRef>> {
    let mut images = Vec::new();
    for frame in frames {
        for ending in ["color.png", "color.jpg"] {
            let path = root.join(format!("{}.{ending}", frame.image.stem));
            if present::file(&path)? {
                images.push(image(path, frame.time_ns, frame.world_from_optical, camera));
            }
        }
    }
    for (path, time_ns) in listed(root)? {
        let pose = pose_at(frames, time_ns);
        images.extend(pose.map(|pose| image(path, Some(time_ns), Some(pose), camera)));
    }
    let Some(first) = images.first().and_then(|image| image.path.as_deref()) else {
        return Ok(images);
    };
    // Only their size: they are read when they are needed, and one that cannot be read is told then.
    if first.extension().is_some_and(|e| e == "png")
        && let Ok(size) = ImageSize::read(first, &files::read(first)?)
        && (size.width, size.height) != (camera.width, camera.height)
    {
        notes.push(format!(
            "colour images of {} x {} pixels are left out: the depth images' camera has {} x {}",
            size.width, size.height, camera.width, camera.height
        ));
        return Ok(Vec::new());
    }
    Ok(images)
}

fn image(path: PathBuf, time_ns: Option<i64>, pose: Option<Pose>, camera: Pinhole) -> ImageRef {
    ImageRef {
        name: files::name(&path),
        time_ns,
        camera,
        distortion: None,
        pose,
        path: Some(path),
    }
}

/// The images of `rgb/` with their times: those of `rgb.txt`, or of their names.
fn listed(root: &Path) -> Result<Vec<(PathBuf, i64)>> {
    let folder = root.join("rgb");
    if !present::folder(&folder)? {
        return Ok(Vec::new());
    }
    let list = root.join("rgb.txt");
    let mut times = std::collections::HashMap::new();
    if present::file(&list)? {
        for line in text::lines(&list, &files::read(&list)?)? {
            if let Some((secs, file)) = line.text.split_once(char::is_whitespace) {
                let time_ns =
                    text::nanoseconds(secs).ok_or_else(|| line.error(format!("{secs:?} is not a time in seconds")))?;
                times.insert(files::name(Path::new(file.trim())), time_ns);
            }
        }
    }
    let images = files::list(&folder, "png")?.into_iter().filter_map(|file| {
        let time_ns = times
            .get(&file.name)
            .copied()
            .or_else(|| Some(ns_after(0, file.secs()?)));
        Some((file.path, time_ns?))
    });
    Ok(images.collect())
}

/// The camera's pose at a time, between those of two depth images.
fn pose_at(frames: &[Frame], time_ns: i64) -> Option<Pose> {
    let next = frames.partition_point(|frame| frame.time_ns.is_some_and(|at| at < time_ns));
    let known = |i: usize| {
        let frame = frames.get(i)?;
        Some((frame.time_ns?, frame.world_from_optical?))
    };
    let (after, before) = (known(next), next.checked_sub(1).and_then(known));
    match (before, after) {
        (_, Some((at, pose))) if at == time_ns => Some(pose),
        (Some((from, a)), Some((to, b))) if secs_between(from, to) <= MOST_SECS => {
            let share = secs_between(from, time_ns) / secs_between(from, to);
            Some(Pose {
                rotation: a.rotation.slerp(b.rotation, share),
                translation: a.translation.lerp(b.translation, share),
            })
        }
        _ => None,
    }
}
