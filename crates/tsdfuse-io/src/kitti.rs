//! KITTI odometry: `velodyne/*.bin`, `calib.txt`, poses of the left grey camera, and images of the two colour cameras.
//!
//! Poses are looked for as `poses.txt` (SemanticKITTI) or another pose file in the folder, and as KITTI lays them out:
//! `../../poses/00.txt` for `sequences/00`. Scans may also lie in `../velodyne`. With P a pose of the camera and Tr the
//! line of `calib.txt`, `world_from_sensor = Tr⁻¹ · P · Tr`: the world is the scanner's frame where KITTI's is the camera's.
//!
//! `image_2/*.png` and `image_3/*.png` belong to the scans of the same names. They are rectified; the lines `P2` and `P3` of `calib.txt` hold
//! their projections K · [1 | t], where t is the place of the left grey camera as the colour camera sees it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use tsdfuse::sensor::Pinhole;

use crate::calib::{self, KITTI_HDL64E_DEG};
use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::folder::{self, ScanFolder};
use crate::source::{ImageRef, OpenOptions, ScanRef, Source};

/// Whether there is a `calib.txt` that tells of a laser scanner, and scans.
pub(crate) fn recognises(path: &Path) -> bool {
    // A broken calib.txt is recognised as well: opening it says what is wrong with it.
    !matches!(calib::in_folder(path), Ok(None)) && scans(path).is_ok_and(|s| !s.is_empty())
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let scans = scans(path)?;
    let poses = folder::poses(path, options, &poses_by_sequence(path))?;
    let folder = ScanFolder::new("KITTI odometry", path, &scans, poses, options)?;
    let images = images(path, folder.scans())?;
    Ok(folder.with_usual_sensor("hdl64e", KITTI_HDL64E_DEG).with_images(images))
}

/// The folders of the colour cameras, and their lines of `calib.txt`.
const CAMERAS: [(&str, &str); 2] = [("image_2", "P2"), ("image_3", "P3")];

/// The images of scans whose poses are known.
fn images(path: &Path, scans: &[ScanRef]) -> Result<Vec<ImageRef>> {
    let Some(camera_from_scanner) = calib::in_folder(path)? else {
        return Ok(Vec::new());
    };
    let mut images = Vec::new();
    for (name, line) in CAMERAS {
        let files = files::list(&path.join(name), "png")?;
        let Some(first) = files.first() else { continue };
        let Some((camera, grey_from_color)) = calib::projection(path, line)? else {
            continue;
        };
        // Only their size: one that cannot be read is told when it is needed.
        let Ok((width, height)) = size(&first.path) else {
            continue;
        };
        let camera = Pinhole {
            width,
            height,
            ..camera
        };
        let scanner_from_color = camera_from_scanner.inverse() * grey_from_color;
        let of_scan: HashMap<&str, &ScanRef> = scans.iter().map(|scan| (stem(&scan.name), scan)).collect();
        images.extend(files.iter().filter_map(|file| {
            let scan = of_scan.get(stem(&file.name))?;
            Some(ImageRef {
                name: format!("{name}/{}", file.name),
                time_ns: scan.time_ns,
                camera,
                distortion: None,
                pose: Some(scan.pose? * scanner_from_color),
                path: Some(file.path.clone()),
            })
        }));
    }
    Ok(images)
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Columns and rows of a PNG.
fn size(path: &Path) -> Result<(u32, u32)> {
    let decoder = ::png::Decoder::new(std::io::Cursor::new(files::read(path)?));
    let reader = decoder.read_info().map_err(|e| Error::format(path, e.to_string()))?;
    Ok(reader.info().size())
}

fn scans(path: &Path) -> Result<Vec<ScanFile>> {
    let here = files::list(&path.join("velodyne"), "bin")?;
    if here.is_empty() {
        return files::list(&path.join("../velodyne"), "bin");
    }
    Ok(here)
}

/// `poses/00.txt` for `sequences/00`.
fn poses_by_sequence(path: &Path) -> PathBuf {
    let name = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let name = name.file_name().unwrap_or_default().to_owned();
    path.join("../../poses").join(name).with_extension("txt")
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::DVec3;

    #[test]
    fn colour_cameras_see_what_the_scanner_measures() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("sequences/07");
        for folder in ["velodyne", "image_2", "image_3"] {
            std::fs::create_dir_all(root.join(folder)).unwrap();
        }
        // The grey camera looks along the scanner's x and sits 10 cm above it; the colour cameras, 6 cm left and 47 cm right of that.
        let p = |x: f64| format!("700 0 600 {} 0 700 180 0.2 0 0 1 0.003", 700.0 * x + 600.0 * 0.003);
        let calib = format!("P2: {}\nP3: {}\nTr: 0 -1 0 0 0 0 -1 0.1 1 0 0 0\n", p(0.06), p(-0.47));
        std::fs::write(root.join("calib.txt"), calib).unwrap();
        let picture = tsdfuse::render::Image {
            width: 1241,
            height: 376,
            pixels: tsdfuse::render::Pixels::Rgb(vec![[9; 3]; 1241 * 376]),
        };
        let mut poses = String::new();
        for number in 0..3 {
            let name = format!("{number:06}");
            std::fs::write(root.join(format!("velodyne/{name}.bin")), [0_u8; 16]).unwrap();
            // In the frame of the grey camera: forward is z.
            poses += &format!("1 0 0 0 0 1 0 0 0 0 1 {number}\n");
            for (folder, _) in CAMERAS {
                // Of one scan there is no image.
                if number != 1 || folder == "image_2" {
                    crate::png::write(root.join(format!("{folder}/{name}.png")), &picture).unwrap();
                }
            }
        }
        std::fs::write(root.join("poses.txt"), poses).unwrap();
        let log = crate::open(&root).unwrap();
        assert_eq!(log.format(), "KITTI odometry");
        let names: Vec<_> = log.images().iter().map(|image| image.name.as_str()).collect();
        let expected = [
            "image_2/000000.png",
            "image_2/000001.png",
            "image_2/000002.png",
            "image_3/000000.png",
            "image_3/000002.png",
        ];
        assert_eq!(names, expected);
        for (image, (x, number)) in log
            .images()
            .iter()
            .zip([(0.06, 0), (0.06, 1), (0.06, 2), (-0.47, 0), (-0.47, 2)])
        {
            assert_eq!((image.camera.width, image.camera.height), (1241, 376));
            // A point 20 m ahead of the scanner at its scan, 3 m to the left and 1 m up, projected as KITTI's paper does: P · Tr · point.
            let point = DVec3::new(20.0, 3.0, 1.0);
            let [u, v, w] = [-3.0, -1.0 + 0.1, 20.0];
            let depth = w + 0.003;
            let pixel = [
                (700.0 * u + 600.0 * w + 700.0 * x + 1.8) / depth,
                (700.0 * v + 180.0 * w + 0.2) / depth,
            ];
            let world = log.scans()[number].pose.unwrap().transform_point(point);
            let seen = image.pose.unwrap().inverse().transform_point(world);
            let camera = &image.camera;
            let found = [
                f64::from(camera.fx) * seen.x / seen.z + f64::from(camera.cx),
                f64::from(camera.fy) * seen.y / seen.z + f64::from(camera.cy),
            ];
            assert!(
                (found[0] - pixel[0]).abs() < 1e-3 && (found[1] - pixel[1]).abs() < 1e-3,
                "{found:?} {pixel:?}"
            );
        }
        assert!(!log.read_image(4).unwrap().is_empty());
    }
}
