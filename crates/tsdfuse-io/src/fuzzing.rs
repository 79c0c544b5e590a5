//! Feeds each parser with arbitrary bytes, for the targets in `fuzz/`. Not part of the library's interface.

use std::path::Path;

use crate::capture::{Datagrams, Records};
use crate::pandaset::{cameras, frames};
use crate::pickle::DataFrame;
use crate::rgbd::image::{self, ImageSize};
use crate::rgbd::{camera, seven_scenes, tum};
use crate::scalar::Scalar;
use crate::{
    bin, calib, cloud, feather, files, folder, g2o, glb, kitti_raw, kitti360, map_file, nclt, nuscenes, obj, pcd, ply,
    poses, records, ros, times,
};

const PATH: &str = "input";

/// A pickled DataFrame, and the columns of a PandaSet scan.
pub fn pickle(bytes: &[u8]) {
    if let Ok(frame) = DataFrame::new(bytes) {
        for name in ["x", "y", "z", "i", "t", "d"] {
            let _ = frame.column(name);
        }
    }
}

/// A saved map, read and repaired. What can be read can be repaired, to the same map.
///
/// # Panics
/// If it cannot.
pub fn map(bytes: &[u8]) {
    // The bytes as they are, and as the groups and as the poses of a file with correct checksums.
    for file in [bytes.to_vec(), map_file::forged(bytes), map_file::forged_poses(bytes)] {
        let read = map_file::parse(Path::new(PATH), file.as_slice());
        let repaired = map_file::repair_bytes(Path::new(PATH), &file);
        if let Ok((map, poses)) = read {
            let same = repaired.is_ok_and(|r| r.map == map && r.poses == poses && r.damage.places.is_empty());
            assert!(same, "what can be read can be repaired");
        }
    }
}

/// Packed blocks, as a store has them. What is unpacked can be packed and unpacked again as the same.
///
/// # Panics
/// If it is another.
pub fn packed(bytes: &[u8]) {
    let unpacked = |bytes: &[u8]| {
        let mut blocks = Vec::new();
        let done = map_file::unpack(bytes, |index, block| {
            blocks.push((index, block));
            Ok(())
        });
        done.map(|()| blocks)
    };
    // The bytes as they are, and as groups with correct checksums.
    let forged = map_file::forged(bytes);
    for groups in [bytes, map_file::groups(&forged)] {
        if let Ok(blocks) = unpacked(groups) {
            let again = map_file::pack(blocks.iter().map(|(index, block)| (*index, block)));
            assert!(
                unpacked(&again).is_ok_and(|again| again == blocks),
                "what is packed is unpacked"
            );
        }
    }
}

pub use map_file::with_group_checksums;

/// The side files of a scan, and the times in its name.
pub fn columns(bytes: &[u8]) {
    let path = Path::new(PATH);
    let _ = bin::column(path, bytes, bytes.len() / 2, u16::from_le_bytes);
    if let Ok(secs) = bin::column(path, bytes, bytes.len() / 4, f32::from_le_bytes) {
        let _ = cloud::checked_offsets(path, secs);
    }
    if let Ok(secs) = bin::column(path, bytes, bytes.len() / 8, f64::from_le_bytes) {
        for scan_secs in [None, Some(0.0), Some(1.5e9)] {
            let _ = cloud::offsets(path, &secs, scan_secs);
        }
    }
    if let Ok(name) = std::str::from_utf8(bytes) {
        let _ = files::secs_in_name(name);
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

/// A PLY mesh. What is read can be written and read again as the same.
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

/// Poses of any kind of file.
pub fn poses(bytes: &[u8]) {
    let _ = poses::parse(Path::new(PATH), bytes);
}

/// A pose graph.
pub fn g2o(bytes: &[u8]) {
    let _ = g2o::parse(Path::new(PATH), bytes);
}

/// The times of scans.
pub fn times(bytes: &[u8]) {
    let _ = times::parse(Path::new(PATH), bytes);
}

/// The tables and records of data sets.
pub fn datasets(bytes: &[u8]) {
    let path = Path::new(PATH);
    nuscenes::parse_tables(bytes);
    let _ = nclt::parse(path, bytes);
    let _ = nclt::parse_poses(path, bytes);
    let _ = kitti360::parse(path, bytes);
    let _ = records::parse(
        path,
        bytes,
        &[
            ("x", Scalar::F32),
            ("y", Scalar::F32),
            ("z", Scalar::F32),
            ("t", Scalar::U32),
        ],
    );
}

/// LAS and E57, where they are built in.
pub fn surveys(bytes: &[u8]) {
    let path = Path::new(PATH);
    let _ = crate::las::parse(path, bytes);
    #[cfg(feature = "e57")]
    let _ = crate::e57::parse(path, bytes);
    let _ = (path, bytes);
}

/// A table of Arrow, as it is and between the marks of a file.
pub fn feather(bytes: &[u8]) {
    let names = ["x", "n", "s"];
    let _ = feather::parse(Path::new(PATH), bytes, &names);
    let file = [
        &b"ARROW1\0\0"[..],
        bytes,
        &(bytes.len() as u32).to_le_bytes(),
        b"ARROW1",
    ]
    .concat();
    let _ = feather::parse(Path::new(PATH), &file, &names);
}

/// KITTI's calibrations and GPS packets.
pub fn kitti(bytes: &[u8]) {
    let _ = calib::parse(Path::new(PATH), bytes, "Tr");
    let _ = calib::parse_rt(Path::new(PATH), bytes);
    let _ = kitti_raw::packet(Path::new(PATH), bytes);
}

/// Poses during each sweep.
pub fn motion(bytes: &[u8]) {
    let _ = folder::parse_motions(Path::new(PATH), bytes);
}

/// The samples of an inertial measurement unit, as they are and after a correct header.
pub fn imu(bytes: &[u8]) {
    let _ = folder::parse_imu(Path::new(PATH), bytes);
    let _ = folder::parse_imu(Path::new(PATH), &[b"t,gx,gy,gz,ax,ay,az\n", bytes].concat());
}

/// The fixes of a GNSS receiver, as they are and after a correct header.
pub fn gnss(bytes: &[u8]) {
    let _ = folder::parse_gnss(Path::new(PATH), bytes);
    let header = b"t,latitude,longitude,altitude,sigma_east,sigma_north,sigma_up\n";
    let _ = folder::parse_gnss(Path::new(PATH), &[header, bytes].concat());
}

/// A capture's records and datagrams, as they are and after the header of each kind of file. No datagram is longer than IP's.
///
/// # Panics
/// If one is.
pub fn capture(bytes: &[u8]) {
    let pcap: &[u8] = &[
        0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 1, 0, 0, 0,
    ];
    let section = [0x0A, 0x0D, 0x0D, 0x0A, 28, 0, 0, 0, 0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0];
    let section = [&section[..], &[0xFF; 8], &[28, 0, 0, 0]].concat();
    for head in [&[], pcap, &section] {
        let file = [head, bytes].concat();
        let Ok(records) = Records::new(Path::new(PATH), file.as_slice()) else {
            continue;
        };
        let mut datagrams = Datagrams::new(records);
        while let Ok(Some(datagram)) = datagrams.next() {
            assert!(
                datagram.payload.len() <= 65_535 && datagram.offset <= file.len() as u64,
                "a datagram"
            );
        }
    }
}

/// The tables of an OSF file: a part of it, with its size in front, as a chunk of messages.
pub fn osf(bytes: &[u8]) {
    crate::osf::parse_part(bytes);
    crate::osf::parse_part(&[&(bytes.len() as u32).to_le_bytes(), bytes].concat());
}

/// A sensor's model.
pub fn sensor(bytes: &[u8]) {
    let _ = crate::sensor_file::parse(Path::new(PATH), bytes);
}

/// A PNG image, as a depth image and as a mask.
pub fn depth_image(bytes: &[u8]) {
    let Ok(size) = ImageSize::read(Path::new(PATH), bytes) else {
        return;
    };
    // Larger images are decoded in the same way, but slowly.
    if size.width * size.height <= 1 << 16 {
        let _ = image::depths(Path::new(PATH), bytes, &size);
        let _ = image::mask(Path::new(PATH), bytes, &size);
    }
}

/// A camera's image.
pub fn photo(bytes: &[u8]) {
    if let Ok(photo) = crate::photo::decode(PATH, bytes) {
        assert_eq!(photo.pixels.len(), photo.width * photo.height);
        let _ = photo.at(0.5, 0.5);
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

/// An MCAP file.
pub fn mcap(bytes: &[u8]) {
    ros::fuzzing::mcap(bytes);
}

/// A ROS 1 bag.
pub fn bag1(bytes: &[u8]) {
    ros::fuzzing::bag1(bytes);
}

/// A ROS message.
pub fn message(bytes: &[u8]) {
    ros::fuzzing::message(bytes);
}

/// The JSON files of PandaSet.
pub fn pandaset(bytes: &[u8]) {
    let _ = frames::parse_poses(Path::new(PATH), bytes);
    let _ = frames::parse_times(Path::new(PATH), bytes, 3);
    let _ = cameras::parse_intrinsics(Path::new(PATH), bytes);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn any_tables_are_bearable(bytes in prop::collection::vec(prop::sample::select(vec![0u8, 1, 2, 4, 6, 8, 16, 30, 255]), 0..200)) {
            osf(&bytes);
        }

        #[test]
        fn any_capture_is_bearable(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            lengths in prop::collection::vec(0u8..60, 0..6),
            kind in prop::sample::select(vec![1u8, 3, 6]),
        ) {
            capture(&bytes);
            // Records and blocks of lengths that fit, with IP in them.
            let (mut records, mut blocks) = (Vec::new(), Vec::new());
            for length in lengths {
                let mut frame: Vec<u8> = [&[0; 12][..], &[8, 0, 0x45, 0, 0, 40, 0, 1, 0x20, 0, 9, 17], &bytes].concat();
                frame.truncate(usize::from(length) / 4 * 4 + 12);
                records.extend([&[0; 8][..], &[frame.len() as u8, 0, 0, 0], &[0; 4], &frame].concat());
                let total = frame.len() as u8 + 12;
                blocks.extend([&[kind, 0, 0, 0, total, 0, 0, 0][..], &frame, &[total, 0, 0, 0]].concat());
            }
            capture(&records);
            capture(&blocks);
        }

        #[test]
        fn any_packed_blocks_and_columns_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            packed(&bytes);
            columns(&bytes);
        }

        #[test]
        fn any_message_is_bearable(bytes in prop::collection::vec(prop_oneof![Just(0u8), Just(1), any::<u8>()], 0..300)) {
            message(&bytes);
            let definition = "float32 x\nfloat32[] y\nany/Any[2] z\nstring[<=4] s\nany/Any[] points\0";
            message(&[definition.as_bytes(), &bytes].concat());
            message(&[b"float32 x\nfloat32 y\nfloat32 z\nuint16 ring\0", &bytes[..]].concat());
            mcap(&[ros::MAGIC_MCAP, &bytes].concat());
            bag1(&[b"#ROSBAG V2.0\n", &bytes[..]].concat());
        }

        #[test]
        fn damaged_recordings_are_bearable(
            which in 0..4usize,
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            let name = ["zstd.mcap", "lz4.mcap", "ros1_lz4.bag", "ros1_bz2.bag"][which];
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/ros").join(name);
            let mut bytes = std::fs::read(path).unwrap();
            for (at, value) in damage {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            if which < 2 { mcap(&bytes) } else { bag1(&bytes) }
        }

        #[test]
        fn any_records_and_any_poses_are_bearable(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            text in "(VERTEX_SE3:QUAT|VERTEX_SE2|[txyz]|q[xyzw]|[,; \n#.0-9-]){0,60}",
        ) {
            datasets(&bytes);
            feather(&bytes);
            datasets(text.as_bytes());
            poses(text.as_bytes());
            poses(&[b"t,x,y,z,qx,qy,qz,qw\n", text.as_bytes()].concat());
        }

        #[test]
        fn any_motion_and_any_samples_are_bearable(numbers in prop::collection::vec(-2..3i8, 0..60), every in 1usize..30) {
            let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
            let lines: Vec<String> = words.chunks(every).map(|line| line.join(" ")).collect();
            motion(lines.join("\n").as_bytes());
            motion(lines.join("\n-\n").as_bytes());
            imu(lines.join("\n").as_bytes());
        }

        #[test]
        fn damaged_groups_are_bearable(
            marks in prop::collection::vec(1u32..1000, 1..4),
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        ) {
            use tsdfuse::{glam::IVec3, index::BlockIndex, map::{Block, Voxel}};
            let blocks: Vec<_> = (0..).zip(&marks).map(|(x, &weight_sum)| {
                let voxel = Voxel { weight_sum, distance_sum: 0 };
                (BlockIndex(IVec3::X * x), Block { voxels: [voxel; 512] })
            }).collect();
            let mut bytes = map_file::pack(blocks.iter().map(|(index, block)| (*index, block)));
            for (at, value) in damage {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            packed(&bytes);
            // The same within correct checksums.
            let group = &bytes[28..];
            packed(&[&[marks.len() as u8], &(group.len() as u16).to_le_bytes()[..], group].concat());
        }
    }
}
