//! The images of a sequence: `camera/NAME/NN.jpg` with `intrinsics.json`, `poses.json` and `timestamps.json` of each camera.
//!
//! Image NN belongs to entry NN of the two lists. The poses are those of the optical frame in the world. Images are found, not
//! decoded; what is wrong with a camera is a note, since scans can be fused without it.

use std::path::Path;

use serde::Deserialize;
use tsdfuse::sensor::Pinhole;
use tsdfuse::trajectory::ns_after;

use super::frames::{parse_poses, parse_times};
use crate::error::{Error, Result};
use crate::files;
use crate::present;
use crate::source::ImageRef;

/// Pixels of all images of PandaSet, which its files do not tell.
const SIZE: (u32, u32) = (1920, 1080);

/// `intrinsics.json`, pixels.
#[derive(Deserialize)]
struct Intrinsics {
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
}

/// The images of all cameras, and a sentence for each camera that cannot be used.
pub(super) fn images(folder: &Path) -> (Vec<ImageRef>, Vec<String>) {
    let (mut images, mut notes) = (Vec::new(), Vec::new());
    let left_out = |what: &str, e: &Error| format!("the images of {what} are left out: {e}");
    let cameras =
        match present::folder(folder).and_then(|there| if there { files::names(folder) } else { Ok(Vec::new()) }) {
            Ok(cameras) => cameras,
            Err(e) => return (images, vec![left_out("all cameras", &e)]),
        };
    for name in cameras.iter().filter(|name| folder.join(name).is_dir()) {
        match of_camera(&folder.join(name), name) {
            Ok(found) => images.extend(found),
            Err(e) => notes.push(left_out(name, &e)),
        }
    }
    (images, notes)
}

fn of_camera(folder: &Path, name: &str) -> Result<Vec<ImageRef>> {
    let [intrinsics, poses, times] =
        ["intrinsics", "poses", "timestamps"].map(|file| folder.join(format!("{file}.json")));
    let camera = parse_intrinsics(&intrinsics, &files::read(&intrinsics)?)?;
    let poses = parse_poses(&poses, &files::read(&poses)?)?;
    let times = parse_times(&times, &files::read(&times)?, poses.len())?;
    let images = files::list(folder, "jpg")?.into_iter().filter_map(|file| {
        let number = file.number()?;
        Some(ImageRef {
            name: format!("{name}/{}", file.name),
            time_ns: times.get(number).map(|&secs| ns_after(0, secs)),
            camera,
            distortion: None,
            pose: poses.get(number).copied(),
            path: Some(file.path),
        })
    });
    Ok(images.collect())
}

/// Parses `intrinsics.json`; `path` is for messages.
///
/// # Errors
/// Names the file and the reason.
pub(crate) fn parse_intrinsics(path: &Path, bytes: &[u8]) -> Result<Pinhole> {
    let Intrinsics { fx, fy, cx, cy } =
        serde_json::from_slice(bytes).map_err(|e| Error::format(path, e.to_string()))?;
    let (width, height) = SIZE;
    let camera = Pinhole {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    };
    camera.check().map_err(|e| Error::format(path, e.to_string()))?;
    Ok(camera)
}
