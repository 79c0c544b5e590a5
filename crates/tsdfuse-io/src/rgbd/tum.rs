//! The layout of TUM RGB-D: `depth/*.png`, `depth.txt` and `groundtruth.txt`.

use std::path::{Component, Path};

use tsdfuse::sensor::Pinhole;
use tsdfuse::trajectory::ns_after;

use super::camera;
use super::image::ImageSize;
use super::layout::{Image, Layout, placed, without_poses};
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::source::OpenOptions;
use crate::{poses, present, text};

/// 5000 is one metre.
const METRES_PER_UNIT: f32 = 1.0 / 5000.0;

/// `fx fy cx cy` of the three Kinects, by what the folder's name holds.
const INTRINSICS: [(&str, &str, [f32; 4]); 3] = [
    ("freiburg1", "fr1", [517.3, 516.5, 318.6, 255.3]),
    ("freiburg2", "fr2", [520.9, 521.0, 325.1, 249.7]),
    ("freiburg3", "fr3", [535.4, 539.2, 320.1, 247.6]),
];

/// What ROS takes a Kinect for that was not calibrated.
const ROS_INTRINSICS: [f32; 4] = [525.0, 525.0, 319.5, 239.5];

/// The depth images in `depth/`.
pub(super) fn images(root: &Path) -> Result<Vec<Image>> {
    let images = files::list(&root.join("depth"), "png")?.into_iter();
    Ok(images.filter_map(|file| Image::new(file, ".png")).collect())
}

pub(super) fn open(root: &Path, images: Vec<Image>, options: &OpenOptions) -> Result<Layout> {
    let list = root.join("depth.txt");
    let (images, times_ns): (_, Option<Vec<_>>) = if present::file(&list)? {
        let (images, times_ns) = parse_list(&list, &files::read(&list)?)?.into_iter().unzip();
        (images, Some(times_ns))
    } else {
        let time = |image: &Image| image.file.secs().map(|secs| ns_after(0, secs));
        let times_ns = images.iter().map(time).collect();
        (images, times_ns)
    };
    let found = options
        .poses
        .clone()
        .map_or_else(|| poses::find(root), |path| Ok(Some(path)))?;
    let mut notes = Vec::new();
    Ok(Layout {
        format: "TUM RGB-D",
        metres_per_unit: METRES_PER_UNIT,
        frames: match found {
            Some(path) => placed(&path, images, times_ns, &mut notes)?,
            None => without_poses(images, times_ns, &mut notes),
        },
        usual_camera,
        notes,
    })
}

/// Parses `depth.txt`: for each image a line with its time and its file, relative to the list's folder.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn parse_list(path: &Path, bytes: &[u8]) -> Result<Vec<(Image, i64)>> {
    let root = path.parent().unwrap_or(Path::new(""));
    let mut images: Vec<(Image, i64)> = Vec::new();
    for line in text::lines(path, bytes)? {
        let (secs, file) = line
            .text
            .split_once(char::is_whitespace)
            .ok_or_else(|| line.error("a time and the name of a file are wanted"))?;
        let not_a_time = || line.error(format!("{secs:?} is not a time in seconds"));
        let (time_ns, file) = (text::nanoseconds(secs).ok_or_else(not_a_time)?, Path::new(file.trim()));
        if images.last().is_some_and(|(_, last)| *last >= time_ns) {
            return Err(line.error(format!("the time {secs} is not later than that of the image before")));
        }
        let inside = file.components().all(|part| matches!(part, Component::Normal(_)));
        let name = files::name(file);
        let image = ScanFile {
            path: root.join(file),
            name,
        };
        match Image::new(image, ".png").filter(|_| inside) {
            Some(image) => images.push((image, time_ns)),
            None => {
                let file = file.display();
                return Err(line.error(format!("{file} is not the name of a PNG file in this folder")));
            }
        }
    }
    if images.is_empty() {
        return Err(Error::format(path, "lists no images"));
    }
    Ok(images)
}

fn usual_camera(root: &Path, size: &ImageSize, notes: &mut Vec<String>) -> Result<Pinhole> {
    let folder = std::fs::canonicalize(root).unwrap_or_else(|_| root.to_owned());
    let name = files::name(&folder).to_ascii_lowercase();
    let known = INTRINSICS
        .iter()
        .find(|(long, short, _)| name.contains(long) || name.contains(short));
    let intrinsics = known.map_or(ROS_INTRINSICS, |(_, _, intrinsics)| *intrinsics);
    let missing = "no camera.toml";
    if known.is_none() {
        let [fx, fy, cx, cy] = intrinsics;
        notes.push(format!(
            "{missing}, and the folder's name tells of no freiburg1, 2 or 3: the camera is taken to be a Kinect as ROS \
             assumes it (fx {fx}, fy {fy}, cx {cx}, cy {cy})"
        ));
    }
    camera::usual(root, size, intrinsics, missing)
}
