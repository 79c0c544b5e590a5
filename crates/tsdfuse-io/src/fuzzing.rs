//! Each parser fed with any bytes, for the targets in `fuzz/`; no part of the library's interface.

use std::path::Path;

use crate::pandaset::{cameras, frames};
use crate::pickle::DataFrame;
use crate::rgbd::image::{self, ImageSize};
use crate::rgbd::{camera, seven_scenes, tum};
use crate::{bin, calib, folder, glb, kitti_raw, map_file, obj, pcd, ply, poses, times};

const PATH: &str = "input";

/// A pickled DataFrame, and the columns of a PandaSet scan.
pub fn pickle(bytes: &[u8]) {
    if let Ok(frame) = DataFrame::new(bytes) {
        for name in ["x", "y", "z", "i", "t", "d"] {
            let _ = frame.column(name);
        }
    }
}

/// A saved map, and what can be had of it. What can be read can be repaired, to the same map.
///
/// # Panics
/// If it cannot.
pub fn map(bytes: &[u8]) {
    // As they are, and as the groups of a file with right checksums.
    for file in [bytes.to_vec(), map_file::forged(bytes)] {
        let read = map_file::parse(Path::new(PATH), file.as_slice());
        let repaired = map_file::repair_bytes(Path::new(PATH), &file);
        if let Ok(read) = read {
            let same = repaired.is_ok_and(|r| r.map == read && r.damage.places.is_empty());
            assert!(same, "what can be read can be repaired");
        }
    }
}

/// A PCD cloud.
pub fn pcd(bytes: &[u8]) {
    let _ = pcd::parse(Path::new(PATH), bytes);
    let _ = pcd::parse_points(Path::new(PATH), bytes);
}

/// A PLY cloud.
pub fn ply_cloud(bytes: &[u8]) {
    let _ = ply::parse_cloud(Path::new(PATH), bytes);
}

/// A PLY mesh; what was read is written and read again as the same.
///
/// # Panics
/// If it is another.
pub fn ply_mesh(bytes: &[u8]) {
    let Ok(mut mesh) = ply::parse_mesh(Path::new(PATH), bytes) else {
        return;
    };
    // Coordinates below 1000 m are written as floats; NaN is not equal to itself.
    mesh.vertices.iter_mut().for_each(|v| *v = v.as_vec3().as_dvec3());
    if mesh.vertices.iter().any(|v| v.is_nan()) || mesh.normals.iter().any(|n| n.is_nan()) {
        return;
    }
    let mut written = Vec::new();
    if ply::write_to(&mut written, &mesh).is_ok() {
        let read = ply::parse_mesh(Path::new(PATH), &written);
        assert!(read.is_ok_and(|read| read == mesh), "what is written is read");
    }
}

/// A mesh as OBJ.
pub fn obj(bytes: &[u8]) {
    let _ = obj::parse(Path::new(PATH), bytes);
}

/// A mesh as GLB, and as the document of one.
pub fn glb(bytes: &[u8]) {
    let _ = glb::parse(Path::new(PATH), bytes);
    let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, part) in [(b"JSON", bytes), (b"BIN\0", &[1; 64])] {
        file.extend((part.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(part);
    }
    let _ = glb::parse(Path::new(PATH), &file);
}

/// KITTI's point file.
pub fn bin(bytes: &[u8]) {
    let _ = bin::parse(Path::new(PATH), bytes);
}

/// Poses, KITTI or TUM.
pub fn poses(bytes: &[u8]) {
    let _ = poses::parse(Path::new(PATH), bytes);
}

/// The times of scans.
pub fn times(bytes: &[u8]) {
    let _ = times::parse(Path::new(PATH), bytes);
}

/// KITTI's calibrations and GPS packets.
pub fn kitti(bytes: &[u8]) {
    let _ = calib::parse(Path::new(PATH), bytes, "Tr");
    let _ = calib::parse_rt(Path::new(PATH), bytes);
    let _ = kitti_raw::packet(Path::new(PATH), bytes);
}

/// A sensor's model.
pub fn sensor(bytes: &[u8]) {
    let _ = folder::parse_sensor(Path::new(PATH), bytes);
}

/// A PNG image, as a depth image and as a mask.
pub fn depth_image(bytes: &[u8]) {
    let Ok(size) = ImageSize::read(Path::new(PATH), bytes) else {
        return;
    };
    // What is larger is decoded in the same way, only slowly.
    if size.width * size.height <= 1 << 16 {
        let _ = image::depths(Path::new(PATH), bytes, &size);
        let _ = image::mask(Path::new(PATH), bytes, &size);
    }
}

/// The text files beside depth images.
pub fn rgbd(bytes: &[u8]) {
    let size = ImageSize {
        width: 640,
        height: 480,
        by: PATH.to_owned(),
    };
    let _ = camera::parse(Path::new(PATH), bytes);
    let _ = camera::parse_matrix(Path::new(PATH), bytes, &size);
    let _ = seven_scenes::parse_pose(Path::new(PATH), bytes);
    let _ = tum::parse_list(Path::new(PATH), bytes);
}

/// The JSON files of PandaSet.
pub fn pandaset(bytes: &[u8]) {
    let _ = frames::parse_poses(Path::new(PATH), bytes);
    let _ = frames::parse_times(Path::new(PATH), bytes, 3);
    let _ = cameras::parse_intrinsics(Path::new(PATH), bytes);
}
