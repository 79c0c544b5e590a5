use std::sync::LazyLock;

use super::format::{CHANGED, END, GROUP, GROUP_HEADER, HEADER, HEADER_1, Header, WITHOUT_POSES, checksum, end_bytes};
use super::group::GroupHeader;
use super::layout::{BLOCK, Layout, push_block};
use super::*;
use proptest::prelude::*;
use tsdfuse::glam::{DQuat, DVec3, IVec3};
use tsdfuse::index::BlockIndex;
use tsdfuse::map::{Block, Voxel};
use tsdfuse::{MapConfig, Pose};

/// A map of three groups, its blocks on both sides of the origin and put in out of order.
fn map() -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig {
        voxel_size_m: 0.1,
        truncation_m: 0.3,
        max_weight: 100.0,
    })
    .unwrap();
    for n in 0..600 {
        let mut block = Block::EMPTY;
        for (i, voxel) in block.voxels.iter_mut().enumerate().skip(n % 500).take(40) {
            voxel.weight_sum = 1000 + (i * n) as u32;
            voxel.distance_sum = 500 - i as i32;
        }
        let n = n as i32 * 7 % 600;
        map.insert_block(BlockIndex(IVec3::new(n % 20 - 10, n / 20 % 5 - 2, n / 100 - 3)), block)
            .unwrap();
    }
    map.set_integrations(77);
    map
}

fn saved(map: &VoxelMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_to(&mut bytes, map, &[]).unwrap();
    bytes
}

fn parsed(bytes: &[u8]) -> Result<VoxelMap, String> {
    parse(Path::new("a.tsdf"), bytes)
        .map(|(map, _)| map)
        .map_err(|e| e.to_string())
}

fn refused(bytes: &[u8]) -> String {
    let told = parsed(bytes).unwrap_err();
    assert!(told.starts_with("a.tsdf: ") && told.lines().count() == 1, "{told}");
    told
}

/// Bytes before the groups where there are no poses.
const START: usize = HEADER + 4 + 20;

/// Where the groups begin, and where the end does.
fn group_offsets(bytes: &[u8]) -> Vec<usize> {
    let mut offsets = vec![START];
    while bytes[offsets[offsets.len() - 1]..].len() > END + 4 {
        let at = offsets[offsets.len() - 1];
        let length = u32::from_le_bytes(bytes[at + 16..at + 20].try_into().unwrap());
        offsets.push(at + GROUP_HEADER + 4 + length as usize);
    }
    offsets
}

/// A file of one group with right checksums that says it has so many blocks.
fn forged(layout: Layout, count: u64, plain: &[u8]) -> Vec<u8> {
    forged_packed(layout, count, &lz4_flex::block::compress(plain))
}

fn forged_packed(layout: Layout, count: u64, packed: &[u8]) -> Vec<u8> {
    let header: [u8; HEADER] = SAVED[..HEADER].try_into().unwrap();
    let group = GroupHeader::bytes(layout, 0, count as usize, packed);
    [&SAVED[..START], &group, packed, &end_bytes(&header, count)].concat()
}

/// The groups of a map as versions 1 to 3 have them: compressed blocks, and how many.
fn groups_of_blocks(map: &VoxelMap, indices: &[BlockIndex]) -> Vec<(Vec<u8>, usize)> {
    let group = |indices: &[BlockIndex]| {
        let mut plain = Vec::new();
        let blocks = indices.iter().map(|&i| (i, map.block(i).unwrap()));
        blocks.for_each(|(index, block)| push_block(index, block, &mut plain));
        (lz4_flex::block::compress(&plain), indices.len())
    };
    indices.chunks(GROUP).map(group).collect()
}

/// A map as version 2 has it, or version 3 with poses.
fn saved_before_planes(map: &VoxelMap, poses: &[FusedPose]) -> Vec<u8> {
    let version = if poses.is_empty() { WITHOUT_POSES } else { 3 };
    let header = Header::bytes(version, map.config(), map.integrations());
    let mut bytes = [&header[..], &checksum(&[&header]).to_le_bytes()].concat();
    if !poses.is_empty() {
        bytes.extend(pack_poses(poses).unwrap());
    }
    let mut indices: Vec<BlockIndex> = map.block_indices();
    indices.sort_by_key(|&index| (tsdfuse::index::RegionIndex::of(index), index));
    for (number, (packed, count)) in (0..).zip(groups_of_blocks(map, &indices)) {
        bytes.extend(GroupHeader::bytes(Layout::Blocks, number, count, &packed));
        bytes.extend(packed);
    }
    bytes.extend(end_bytes(&header, indices.len() as u64));
    bytes
}

/// A map as version 1 has it.
fn saved_1(map: &VoxelMap) -> Vec<u8> {
    let indices = map.block_indices();
    let mut bytes = Header::bytes(2, map.config(), 0)[..HEADER - 4].to_vec();
    bytes[8] = 1;
    bytes.extend((indices.len() as u64).to_le_bytes());
    assert_eq!(bytes.len(), HEADER_1);
    bytes.extend(checksum(&[&bytes]).to_le_bytes());
    for (packed, _) in groups_of_blocks(map, &indices) {
        let length = (packed.len() as u32).to_le_bytes();
        bytes.extend(length);
        bytes.extend(checksum(&[&length, &packed]).to_le_bytes());
        bytes.extend(packed);
    }
    bytes
}

/// The bytes of an empty block, as versions 1 to 3 have it.
fn empty_block(x: i32) -> Vec<u8> {
    let mut block = vec![0; BLOCK];
    block[..4].copy_from_slice(&x.to_le_bytes());
    block
}

#[test]
fn what_is_written_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tsdf");
    let map = map();
    assert!(!recognises(&path));
    write(&path, &map).unwrap();
    assert!(recognises(&path));
    let again = read(&path).unwrap();
    assert!(again == map && again.integrations() == 77);
    assert_eq!(group_offsets(&std::fs::read(&path).unwrap()).len(), 4);
    let empty = VoxelMap::new(MapConfig::default()).unwrap();
    assert!(parsed(&saved(&empty)).unwrap() == empty);
    assert_eq!(saved(&empty).len(), START + END + 4);
}

#[test]
fn maps_of_version_1_are_read() {
    let bytes = saved_1(&map());
    let reader = Reader::new("a.tsdf", &bytes[..]).unwrap();
    assert!(!reader.tells_integrations());
    let read = reader.map().unwrap();
    assert!(read == map() && read.integrations() == 0);
    let mut flipped = bytes.clone();
    flipped[bytes.len() - 500] ^= 1;
    assert_eq!(
        refused(&flipped),
        format!("a.tsdf: group 3 of 3 (88 of 600 blocks): {CHANGED}")
    );
    assert_eq!(
        refused(&[&bytes[..], &[0]].concat()),
        "a.tsdf: bytes follow the last of 600 blocks"
    );
    assert!(refused(&bytes[..bytes.len() - 1]).contains("the file ends within group 3 of 3"));
    assert!(repair_bytes(Path::new("a.tsdf"), &bytes).unwrap().map == map());
    assert!(repair_bytes(Path::new("a.tsdf"), &flipped).is_err());
}

#[test]
fn maps_of_versions_2_and_3_are_read() {
    let map = &*MAP;
    for poses in [Vec::new(), poses()] {
        let bytes = saved_before_planes(map, &poses);
        let (read, with) = parse(Path::new("a.tsdf"), bytes.as_slice()).unwrap();
        assert!(read == *map && read.integrations() == 77 && with == poses);
        let repaired = repair_bytes(Path::new("a.tsdf"), &bytes).unwrap();
        assert!(repaired.map == *map && repaired.poses == poses && repaired.damage.places.is_empty());
        let mut flipped = bytes.clone();
        flipped[bytes.len() - 100] ^= 1;
        assert_eq!(refused(&flipped), format!("a.tsdf: group 3: {CHANGED}"));
        let left = repair_bytes(Path::new("a.tsdf"), &flipped).unwrap();
        assert_eq!((left.map.block_count(), left.damage.lost_blocks), (512, Some(88)));
        // What is written now is smaller.
        assert!(saved(map).len() < bytes.len());
    }
}

#[test]
fn blocks_out_of_order_are_not_written() {
    let mut writer = Writer::new(Vec::new(), &MapConfig::default(), 0).unwrap();
    let mut write = |x, y| writer.block(BlockIndex(IVec3::new(x, y, 0)), &Block::EMPTY);
    // The region comes first: block (0, 1, 0) of the first one goes before (8, 0, 0) of the next.
    write(0, 0).unwrap();
    write(0, 1).unwrap();
    write(8, 0).unwrap();
    for (x, y) in [(8, 0), (1, 1)] {
        assert!(write(x, y).unwrap_err().to_string().ends_with("is not in order"));
    }
}

#[test]
fn the_bytes_are_as_documented() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    map.set_integrations(9);
    let mut block = Block::EMPTY;
    block.voxels[0] = Voxel {
        weight_sum: 0x0102_0304,
        distance_sum: -2,
    };
    map.insert_block(BlockIndex(IVec3::new(-1, 2, 3)), block).unwrap();
    let mut block = Block::EMPTY;
    block.voxels[9] = Voxel {
        weight_sum: 0x101,
        distance_sum: 3,
    };
    map.insert_block(BlockIndex(IVec3::new(0, 2, 3)), block).unwrap();
    let bytes = saved(&map);
    let mut header = b"TSDFMAP\n\x04\0\0\0\0\x80\0\0".to_vec();
    header.extend(0.05f64.to_le_bytes());
    header.extend(0.20f64.to_le_bytes());
    header.extend(32768f32.to_le_bytes());
    header.extend(9u32.to_le_bytes());
    assert_eq!(bytes[..40], header);
    let crc = |bytes: &[u8]| crc32fast::hash(bytes).to_le_bytes();
    assert_eq!(bytes[40..44], crc(&header));
    assert_eq!(bytes[44..60], *b"TSDFPOS\n\0\0\0\0\0\0\0\0");
    assert_eq!(bytes[60..64], crc(&bytes[44..60]));
    let end = bytes.len() - 60;
    let mut group = b"TSDFPLN\n\0\0\0\0\x02\0\0\0".to_vec();
    group.extend((end as u32 - 92).to_le_bytes());
    group.extend(crc(&bytes[92..end]));
    assert_eq!(bytes[64..88], group);
    assert_eq!(bytes[88..92], crc(&group));
    let mut last = [&b"TSDFEND\n"[..], &header].concat();
    last.extend(2u64.to_le_bytes());
    assert_eq!(bytes[end..end + 56], last);
    assert_eq!(bytes[end + 56..], crc(&last));
    let plain = lz4_flex::block::decompress(&bytes[92..end], 2 * 4172).unwrap();
    let places = [
        255, 255, 255, 255, 2, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0,
    ];
    let mut masks = [0; 128];
    (masks[0], masks[64 + 1]) = (1, 2);
    // Distances of -2 and 3 are 3 and 6.
    let planes = [[4, 1], [3, 1], [2, 0], [1, 0], [3, 6], [0, 0], [0, 0], [0, 0]];
    assert_eq!(plain, [&places[..], &masks, planes.as_flattened()].concat());
}

#[test]
fn damage_is_named_by_its_group() {
    let bytes = saved(&map());
    let offsets = group_offsets(&bytes);
    let flipped = |at: usize| {
        let mut bytes = bytes.clone();
        bytes[at] ^= 0x10;
        refused(&bytes)
    };
    assert_eq!(flipped(offsets[1] + 500), format!("a.tsdf: group 2: {CHANGED}"));
    assert_eq!(flipped(offsets[2] + 17), format!("a.tsdf: group 3: {CHANGED}"));
    assert_eq!(flipped(offsets[0] + 3), format!("a.tsdf: group 1: {CHANGED}"));
    assert!(flipped(3).ends_with("its header: this is no map saved by tsdfuse"));
    assert!(flipped(8).ends_with("its header: it has version 20, read are versions up to 4"));
    assert!(flipped(20).ends_with(&format!("its header: {CHANGED}")));
    assert_eq!(flipped(bytes.len() - 10), format!("a.tsdf: group 4: {CHANGED}"));
    let told = refused(&bytes[..offsets[2] - 1]);
    assert_eq!(told, "a.tsdf: the file ends within group 2");
    assert_eq!(refused(&bytes[..40]), "a.tsdf: the file ends within its header");
    let longer = [&bytes[..], &[0]].concat();
    assert_eq!(refused(&longer), "a.tsdf: bytes follow the last of 600 blocks");
    let without_second = [&bytes[..offsets[1]], &bytes[offsets[2]..]].concat();
    assert_eq!(
        refused(&without_second),
        "a.tsdf: group 2: it is group 3, so others are missing"
    );
    let without_last = [&bytes[..offsets[2]], &bytes[offsets[3]..]].concat();
    assert!(refused(&without_last).contains("the file ends after 512 blocks; at its end it says that it has 600"));
}

#[test]
fn packed_blocks_are_unpacked_and_damage_is_told() {
    let map = &*MAP;
    let all: Vec<BlockIndex> = map.block_indices();
    for blocks in [0, 1, 256, 600] {
        let some = || all[..blocks].iter().map(|&i| (i, map.block(i).unwrap()));
        let packed = pack(some());
        let mut unpacked = Vec::new();
        let mut take = |index, block| {
            unpacked.push((index, block));
            Ok(())
        };
        unpack(&packed, &mut take).unwrap();
        assert!(unpacked.iter().map(|(index, block)| (*index, block)).eq(some()));
        for at in [0, 10, 20, packed.len() / 2, packed.len().saturating_sub(1)] {
            let mut damaged = packed.clone();
            let Some(byte) = damaged.get_mut(at) else { continue };
            *byte ^= 4;
            assert!(unpack(&damaged, |_, _| Ok(())).is_err(), "{at}");
            assert!(at == 0 || unpack(&packed[..at], |_, _| Ok(())).is_err(), "{at}");
        }
    }
}

#[test]
fn impossible_content_is_refused_although_its_checksum_is_right() {
    let of = |blocks: &[Vec<u8>]| parsed(&forged(Layout::Blocks, blocks.len() as u64, &blocks.concat()));
    assert_eq!(of(&[empty_block(1), empty_block(2)]).unwrap().block_count(), 2);
    let told = |blocks: &[Vec<u8>]| of(blocks).unwrap_err();
    assert!(told(&[empty_block(1), empty_block(1)]).ends_with("block [1, 0, 0] is not in order"));
    assert!(told(&[empty_block(i32::MAX)]).contains("outside of the grid"));
    let mut voxel = empty_block(1);
    voxel[12..20].copy_from_slice(&[1, 0, 0, 0, 2, 0, 0, 0]);
    assert!(told(&[voxel]).ends_with("block [1, 0, 0]: voxel 0 cannot hold a weight of 1 and a distance of 2"));
    // A group promises other than there is.
    let blocks = |count, plain: &[u8]| refused(&forged(Layout::Blocks, count, plain));
    assert!(blocks(257, &empty_block(1).repeat(257)).contains("it has 257 blocks; 1 to 256 are possible"));
    assert!(blocks(0, &[]).contains("it has 0 blocks"));
    assert!(blocks(2, &empty_block(1)).contains("4108 bytes instead of 8216"));
    assert!(blocks(1, &[empty_block(1), empty_block(2)].concat()).contains("group 1: "));
    // One block by planes, with one voxel of weight 1 and distance 2.
    let one = |bytes: [u8; 8]| [&[0; 12][..], &[1], &[0; 63], &bytes].concat();
    let planes = |count, plain: &[u8]| refused(&forged(Layout::Planes, count, plain));
    assert!(
        planes(1, &one([1, 0, 0, 0, 4, 0, 0, 0])).ends_with("voxel 0 cannot hold a weight of 1 and a distance of 2")
    );
    assert!(parsed(&forged(Layout::Planes, 1, &one([1, 0, 0, 0, 1, 0, 0, 0]))).is_ok());
    for (count, length) in [(1, 0), (1, 11), (1, 75), (1, 76), (1, 83), (2, 84)] {
        let told = planes(count, &one([0; 8])[..length]);
        assert!(
            told.ends_with(&format!("group 1: {length} bytes do not fit its blocks")),
            "{told}"
        );
    }
    assert!(planes(1, &[&one([0; 8])[..], &[0]].concat()).ends_with("85 bytes do not fit its blocks"));
}

/// What is left of [`SAVED`] after a change of its bytes, and what is said of it.
fn repaired(change: impl FnOnce(&mut Vec<u8>)) -> Repaired {
    let mut bytes = SAVED.clone();
    change(&mut bytes);
    repair_bytes(Path::new("a.tsdf"), &bytes).unwrap()
}

#[test]
fn what_is_intact_is_recovered() {
    let (whole, offsets) = (map(), group_offsets(&SAVED));
    let check = |repaired: &Repaired, blocks: usize, lost: Option<u64>, places: &[&str]| {
        let Repaired { map, damage, .. } = repaired;
        assert_eq!(
            (map.block_count(), map.integrations(), damage.lost_blocks),
            (blocks, 77, lost)
        );
        assert!(map.block_indices().iter().all(|&i| map.block(i) == whole.block(i)));
        assert_eq!(map.config(), whole.config());
        assert_eq!(damage.places, places);
    };
    check(&repaired(|_| ()), 600, Some(0), &[]);
    let (first, second) = (offsets[1], offsets[2] - 1);
    // A byte of a group, of its length, or of its mark: that group is lost, and nothing else.
    for at in [first + 300, first + 17, first] {
        let told = repaired(|bytes| bytes[at] ^= 4);
        let what = if at == first { "no group begins there" } else { CHANGED };
        let places = [&*format!("bytes {first} to {second}: {what}"), "group 2 is lost"];
        check(&told, 344, Some(256), &places);
    }
    // The header: its copy is used.
    check(
        &repaired(|bytes| bytes[20] ^= 4),
        600,
        Some(0),
        &[&format!("the header: {CHANGED}; its copy is used")],
    );
    // The file was cut off, or part of it is missing.
    let cut = repaired(|bytes| bytes.truncate(offsets[2] + 100));
    let place = format!("bytes {} to {}: the file ends within them", offsets[2], offsets[2] + 99);
    check(&cut, 512, None, &[&place, "the end is missing"]);
    let out = repaired(|bytes| drop(bytes.drain(offsets[0] + 50..offsets[2])));
    assert_eq!((out.map.block_count(), out.damage.lost_blocks), (88, Some(512)));
    assert_eq!(out.damage.places[1], "groups 1 to 2 are lost");
    // Nothing tells what the voxels are.
    let mut headless = SAVED.clone();
    headless[20] ^= 4;
    headless.truncate(offsets[3]);
    let told = repair_bytes(Path::new("a.tsdf"), &headless).unwrap_err().to_string();
    assert_eq!(told, format!("a.tsdf: its header: {CHANGED}"));
}

/// [`map`], made once.
static MAP: LazyLock<VoxelMap> = LazyLock::new(map);

/// [`map`], saved once.
static SAVED: LazyLock<Vec<u8>> = LazyLock::new(|| saved(&map()));

proptest! {
    #[test]
    fn any_flipped_byte_is_detected(at in any::<prop::sample::Index>(), change in 1..=255u8) {
        let mut bytes = SAVED.clone();
        let at = at.index(bytes.len());
        bytes[at] ^= change;
        refused(&bytes);
    }

    #[test]
    fn any_shortened_file_is_detected(length in any::<prop::sample::Index>()) {
        refused(&SAVED[..length.index(SAVED.len())]);
    }

    #[test]
    fn any_damage_is_repaired_or_named_and_nothing_false_is_recovered(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 1..=255u8), 1..6),
        length in any::<prop::sample::Index>(),
    ) {
        let mut bytes = SAVED.clone();
        for (at, change) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= change;
        }
        bytes.truncate(bytes.len() - length.index(bytes.len()) / 3);
        if let Ok(Repaired { map: left, damage, .. }) = repair_bytes(Path::new("a.tsdf"), &bytes) {
            let whole = &*MAP;
            prop_assert!(left.block_indices().iter().all(|&i| left.block(i) == whole.block(i)));
            prop_assert!(left == *whole || !damage.places.is_empty());
        }
    }

    #[test]
    fn any_bytes_give_an_error_or_a_map(bytes in prop::collection::vec(any::<u8>(), 0..2000), count in 0..600u64) {
        crate::fuzzing::map(&bytes);
        for layout in [Layout::Blocks, Layout::Planes] {
            let _ = parsed(&forged(layout, count, &bytes));
            // As compressed bytes, with a right checksum.
            let _ = parsed(&forged_packed(layout, count, &bytes));
        }
    }
}

#[test]
fn a_map_without_memory_is_not_taken_for_a_damaged_file() {
    let limited = || {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        map.set_memory_limit(0);
        map
    };
    let told = "the map needs more than 0.0 MiB, its memory limit";
    let mut map = limited();
    let file = saved(&self::map());
    let reader = Reader::new("a.tsdf", file.as_slice()).unwrap();
    let error = reader.for_each_block(|index, block| map.insert_block(index, block));
    assert_eq!(error.unwrap_err().to_string(), format!("a.tsdf: {told}"));
    let packed = pack([(BlockIndex(IVec3::ZERO), &Block::EMPTY)]);
    let error = unpack(&packed, |index, block| limited().insert_block(index, block)).unwrap_err();
    assert_eq!(
        (error.kind(), error.to_string()),
        (io::ErrorKind::OutOfMemory, told.to_owned())
    );
    let error = repair::into(Path::new("a.tsdf"), &file, |_| Ok(limited())).unwrap_err();
    assert_eq!(error.to_string(), format!("a.tsdf: {told}"));
}

/// Poses with and without times, not in order of time.
fn poses() -> Vec<FusedPose> {
    let pose = |i: i64| FusedPose {
        time_ns: (i % 7 != 0).then_some(1_583_836_591_182_590_976 - i),
        pose: Pose {
            rotation: DQuat::from_rotation_z(0.1 * i as f64),
            translation: DVec3::new(i as f64, -0.5, 691_000.25),
        },
    };
    (0..300).map(pose).collect()
}

fn with_poses(map: &VoxelMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_to(&mut bytes, map, &poses()).unwrap();
    bytes
}

/// Bytes of the poses' section of 300 poses.
const POSES: usize = 20 + 64 * 300;

#[test]
fn poses_are_kept_and_change_nothing_else() {
    let (map, plain, bytes) = (map(), saved(&map()), with_poses(&map()));
    assert_eq!(parse(Path::new("a.tsdf"), bytes.as_slice()).unwrap(), (map, poses()));
    assert_eq!(bytes[44 + POSES..], plain[START..]);
    assert_eq!(parse(Path::new("a.tsdf"), plain.as_slice()).unwrap().1, []);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tsdf");
    write_with_poses(&path, &self::map(), &poses()).unwrap();
    assert_eq!(read_with_poses(&path).unwrap(), (self::map(), poses()));
    assert_eq!(Reader::open(&path).unwrap().poses().len(), 300);
    assert_eq!(read(&path).unwrap(), self::map());
}

/// As `docs/map-format.md` describes them.
#[test]
fn the_bytes_of_poses_are_as_documented() {
    let bytes = &with_poses(&map())[44..];
    assert_eq!(bytes[..12], *b"TSDFPOS\n\x2c\x01\0\0");
    let crc = |bytes: &[u8]| crc32fast::hash(bytes).to_le_bytes();
    assert_eq!(bytes[12..16], crc(&bytes[20..POSES]));
    assert_eq!(bytes[16..20], crc(&bytes[..16]));
    assert_eq!(bytes[20..28], i64::MIN.to_le_bytes());
    let second: Vec<f64> = bytes[92..148]
        .as_chunks()
        .0
        .iter()
        .map(|&b| f64::from_le_bytes(b))
        .collect();
    assert_eq!(bytes[84..92], 1_583_836_591_182_590_975i64.to_le_bytes());
    assert_eq!(second, [1.0, -0.5, 691_000.25, 0.0, 0.0, 0.05f64.sin(), 0.05f64.cos()]);
}

#[test]
fn damaged_poses_are_lost_and_the_blocks_are_kept() {
    let (map, bytes) = (map(), with_poses(&map()));
    let whole = repair_bytes(Path::new("a.tsdf"), &bytes).unwrap();
    assert_eq!(
        (whole.map == map, whole.poses, whole.damage.places.len()),
        (true, poses(), 0)
    );
    for at in [0, 9, 13, 17, 20, 5000] {
        let mut bytes = bytes.clone();
        bytes[44 + at] ^= 4;
        assert_eq!(refused(&bytes), format!("a.tsdf: its trajectory: {CHANGED}"));
        let Repaired {
            map: left,
            poses,
            damage,
        } = repair_bytes(Path::new("a.tsdf"), &bytes).unwrap();
        assert_eq!((left == map, poses.len(), damage.lost_blocks), (true, 0, Some(0)));
        let place = format!("bytes 44 to {}: {CHANGED}; the trajectory is lost", 43 + POSES);
        assert_eq!(damage.places, [place]);
    }
    // Damage elsewhere leaves the poses.
    let mut broken = bytes.clone();
    broken[44 + POSES + 300] ^= 4;
    broken[20] ^= 4;
    let left = repair_bytes(Path::new("a.tsdf"), &broken).unwrap();
    assert_eq!((left.poses, left.damage.lost_blocks), (poses(), Some(256)));
    let cut = repair_bytes(Path::new("a.tsdf"), &bytes[..5000]).unwrap();
    assert_eq!(
        cut.damage.places,
        [
            "bytes 44 to 4999: the file ends within them; the trajectory is lost",
            "the end is missing"
        ]
    );
    assert_eq!(refused(&bytes[..5000]), "a.tsdf: the file ends within its trajectory");
}

#[test]
fn what_is_no_pose_is_refused_although_its_checksum_is_right() {
    let mut poses = poses();
    let packed = |poses: &[FusedPose]| unpack_poses(&pack_poses(poses).unwrap()).map_err(|e| e.to_string());
    assert_eq!(packed(&poses), Ok(poses.clone()));
    poses[7].pose.rotation = DQuat::from_xyzw(1.0, 1.0, 0.0, 0.0);
    assert!(packed(&poses).unwrap_err().starts_with("pose 7: the pose is not rigid"));
    poses[3].pose.translation.x = f64::NAN;
    assert_eq!(
        packed(&poses).unwrap_err(),
        "pose 3: the pose holds a number that is not finite"
    );
    let longer = [&pack_poses(&[]).unwrap()[..], &[0]].concat();
    assert_eq!(
        unpack_poses(&longer).unwrap_err().to_string(),
        "bytes follow the last pose"
    );
    // A count without poses takes no memory.
    let mut many = b"TSDFPOS\n\xff\xff\xff\xff\0\0\0\0".to_vec();
    many.extend(checksum(&[&many]).to_le_bytes());
    assert!(unpack_poses(&many).is_err());
}
