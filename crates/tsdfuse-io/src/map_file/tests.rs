use std::sync::LazyLock;

use super::*;
use proptest::prelude::*;

/// A map of three groups, its blocks on both sides of the origin and put in out of order.
fn map() -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig {
        voxel_size_m: 0.1,
        truncation_m: 0.3,
        max_weight: 100.0,
    })
    .unwrap();
    for n in 0..600 {
        let mut block = Block {
            voxels: [Voxel::default(); BLOCK_VOXELS],
        };
        for (i, voxel) in block.voxels.iter_mut().enumerate().skip(n % 500).take(40) {
            voxel.weight_sum = 1000 + (i * n) as u32;
            voxel.distance_sum = 500 - i as i32;
        }
        let n = n as i32 * 7 % 600;
        map.insert_block(BlockIndex(IVec3::new(n % 20 - 10, n / 20 % 5 - 2, n / 100 - 3)), block)
            .unwrap();
    }
    map
}

fn saved(map: &VoxelMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_to(&mut bytes, map).unwrap();
    bytes
}

fn parsed(bytes: &[u8]) -> Result<VoxelMap, String> {
    parse(Path::new("a.tsdf"), bytes).map_err(|e| e.to_string())
}

fn refused(bytes: &[u8]) -> String {
    let told = parsed(bytes).unwrap_err();
    assert!(told.starts_with("a.tsdf: ") && told.lines().count() == 1, "{told}");
    told
}

/// Where the groups begin, and where the last one ends.
fn group_offsets(bytes: &[u8]) -> Vec<usize> {
    let mut offsets = vec![HEADER + 4];
    while offsets[offsets.len() - 1] < bytes.len() {
        let at = offsets[offsets.len() - 1];
        offsets.push(at + 8 + u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize);
    }
    offsets
}

/// A file with the header of `count` blocks, and one group with right checksums.
fn forged(count: u64, plain: &[u8]) -> Vec<u8> {
    let mut bytes = SAVED[..HEADER].to_vec();
    bytes[HEADER - 8..].copy_from_slice(&count.to_le_bytes());
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    let packed = lz4_flex::block::compress(plain);
    let length = (packed.len() as u32).to_le_bytes();
    bytes.extend(length);
    bytes.extend(checksum(length, &packed).to_le_bytes());
    bytes.extend(packed);
    bytes
}

/// The bytes of an empty block.
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
    assert!(read(&path).unwrap() == map);
    assert_eq!(group_offsets(&std::fs::read(&path).unwrap()).len(), 4);
    let empty = VoxelMap::new(MapConfig::default()).unwrap();
    assert!(parsed(&saved(&empty)).unwrap() == empty);
    assert_eq!(saved(&empty).len(), HEADER + 4);
}

#[test]
fn the_bytes_are_as_documented() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    let mut block = Block {
        voxels: [Voxel::default(); BLOCK_VOXELS],
    };
    block.voxels[0] = Voxel {
        weight_sum: 0x0102_0304,
        distance_sum: -2,
    };
    map.insert_block(BlockIndex(IVec3::new(-1, 2, 3)), block).unwrap();
    let bytes = saved(&map);
    let mut header = b"TSDFMAP\n\x01\0\0\0\0\x80\0\0".to_vec();
    header.extend(0.05f64.to_le_bytes());
    header.extend(0.20f64.to_le_bytes());
    header.extend(32768f32.to_le_bytes());
    header.extend(1u64.to_le_bytes());
    assert_eq!(bytes[..44], header);
    let plain = lz4_flex::block::decompress(&bytes[56..], BLOCK).unwrap();
    assert_eq!(plain.len(), 4108);
    assert_eq!(
        plain[..20],
        [
            255, 255, 255, 255, 2, 0, 0, 0, 3, 0, 0, 0, 4, 3, 2, 1, 254, 255, 255, 255
        ]
    );
    assert!(plain[20..].iter().all(|&b| b == 0));
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
    assert_eq!(
        flipped(offsets[1] + 500),
        format!("a.tsdf: group 2 of 3 (256 of 600 blocks): {CHANGED}")
    );
    assert!(flipped(offsets[2] + 500).contains("group 3 of 3 (88 of 600 blocks): "));
    assert!(flipped(offsets[0] + 3).contains("group 1 of 3 (256 of 600 blocks): 268"));
    assert!(flipped(3).ends_with("its header: this is no map saved by tsdfuse"));
    assert!(flipped(8).ends_with("its header: it has version 17, read is version 1"));
    assert!(flipped(20).ends_with(&format!("its header: {CHANGED}")));
    let told = refused(&bytes[..offsets[2] - 1]);
    assert_eq!(told, "a.tsdf: the file ends within group 2 of 3 (256 of 600 blocks)");
    assert_eq!(refused(&bytes[..40]), "a.tsdf: the file ends within its header");
    let longer = [&bytes[..], &[0]].concat();
    assert_eq!(refused(&longer), "a.tsdf: bytes follow the last of 600 blocks");
    let exchanged = [
        &bytes[..offsets[0]],
        &bytes[offsets[1]..offsets[2]],
        &bytes[offsets[0]..offsets[1]],
        &bytes[offsets[2]..],
    ]
    .concat();
    assert!(refused(&exchanged).contains("group 2 of 3 (256 of 600 blocks): block [-10, -2, -3] is not in order"));
}

#[test]
fn impossible_content_is_refused_although_its_checksum_is_right() {
    let of = |blocks: &[Vec<u8>]| parsed(&forged(blocks.len() as u64, &blocks.concat()));
    assert_eq!(of(&[empty_block(1), empty_block(2)]).unwrap().block_count(), 2);
    let told = |blocks: &[Vec<u8>]| of(blocks).unwrap_err();
    assert!(told(&[empty_block(1), empty_block(1)]).ends_with("block [1, 0, 0] is not in order"));
    assert!(told(&[empty_block(i32::MAX)]).contains("outside of the grid"));
    let mut voxel = empty_block(1);
    voxel[12..20].copy_from_slice(&[1, 0, 0, 0, 2, 0, 0, 0]);
    assert!(told(&[voxel]).ends_with("block [1, 0, 0]: voxel 0 cannot hold a weight of 1 and a distance of 2"));
    // The header promises more, or other, than there is.
    let none = refused(&forged(u64::MAX, &empty_block(1).repeat(256)));
    assert!(none.contains("group 1 of 72057594037927936"), "{none}");
    assert!(refused(&forged(2, &empty_block(1))).contains("4108 bytes instead of 8216"));
    assert!(refused(&forged(1, &[empty_block(1), empty_block(2)].concat())).contains("group 1 of 1"));
}

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
    fn any_bytes_give_an_error_or_a_map(
        bytes in prop::collection::vec(any::<u8>(), 0..2000),
        length in any::<u16>(),
        count in 0..600u64,
    ) {
        let _ = parsed(&bytes);
        let _ = parsed(&forged(count, &bytes));
        // As compressed bytes, with a right checksum.
        let mut file = forged(count, &[]);
        file.truncate(HEADER + 4);
        let length = [length.to_le_bytes(), [0; 2]].concat().try_into().unwrap();
        let own = (bytes.len() as u32).to_le_bytes();
        for length in [length, own] {
            let packed = [&length[..], &checksum(length, &bytes).to_le_bytes(), &bytes].concat();
            let _ = parsed(&[&file[..], &packed].concat());
        }
    }
}
