//! Stores that are not as they were written.

use std::path::Path;

use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use tsdfuse::VoxelMap;
use tsdfuse::fuse::Method;
use tsdfuse_store::{PagedMap, Salvage, StoreError};

use super::{LITTLE, all_of, drive, fused, fused_with_little, new_store};

/// Harmed files that are tried.
const CASES: usize = 400;

/// A store with two commits and regions that were written after the last one; the map of the last commit.
fn a_store(path: &Path) -> VoxelMap {
    let (sensor, scans) = drive();
    let mut paged = new_store(path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..16], &[8, 12]);
    fused(Method::Raycast, &sensor, &scans[..12])
}

/// Reads everything that a store holds.
fn read(path: &Path, is_read_only: bool) -> tsdfuse_store::Result<(VoxelMap, Vec<u8>)> {
    let (mut paged, checkpoint) = if is_read_only {
        PagedMap::open_read_only(path, LITTLE)?
    } else {
        PagedMap::open(path, LITTLE)?
    };
    Ok((all_of(&mut paged)?, checkpoint))
}

/// What happens to a file.
#[derive(Clone, Debug)]
enum Harm {
    Flip(Vec<(u64, u8)>),
    Cut(u64),
    Zero(u64, u64),
    Copy(u64, u64, u64),
}

impl Harm {
    fn to(&self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        let length = bytes.len() as u64;
        let range = |from: u64, count: u64| (from % length) as usize..((from % length + count).min(length)) as usize;
        match self {
            Self::Flip(flips) => {
                for (at, bits) in flips {
                    bytes[(at % length) as usize] ^= bits;
                }
            }
            Self::Cut(at) => bytes.truncate((at % length) as usize),
            Self::Zero(from, count) => bytes[range(*from, *count)].fill(0),
            Self::Copy(from, to, count) => {
                let from = range(*from, *count);
                let to = range(*to, from.len() as u64);
                let from = from.start..from.start + to.len();
                bytes.copy_within(from, to.start);
            }
        }
        bytes
    }
}

fn harm() -> impl Strategy<Value = Harm> {
    // Places in the headers and anywhere, of pages and of bytes.
    let at = || {
        prop_oneof![
            0..8192_u64,
            0..2_u64.pow(40),
            (0..2_u64.pow(28)).prop_map(|page| page * 4096)
        ]
    };
    let count = || prop_oneof![1..16_u64, 1..100_000_u64, Just(4096_u64)];
    prop_oneof![
        prop::collection::vec((at(), 1..=255_u8), 1..4).prop_map(Harm::Flip),
        at().prop_map(Harm::Cut),
        (at(), count()).prop_map(|(from, count)| Harm::Zero(from, count)),
        (at(), at(), count()).prop_map(|(from, to, count)| Harm::Copy(from, to, count)),
    ]
}

/// Reads and salvages harmed files; counts those whose damage was told, and those of which most was recovered.
#[test]
fn damage_is_told_or_does_not_matter_and_what_is_intact_is_recovered() {
    let dir = tempfile::tempdir().unwrap();
    let (path, harmed) = (dir.path().join("a.store"), dir.path().join("b.store"));
    let expected = a_store(&path);
    let bytes = std::fs::read(&path).unwrap();
    let (mut told, mut recovered) = (0, 0);
    let mut runner = TestRunner::deterministic();
    let fixed = [
        Harm::Cut(bytes.len() as u64 - 4096),
        Harm::Zero(64, 8128),
        Harm::Zero(8192, 1 << 16),
    ];
    let any = (0..CASES).map(|_| harm().new_tree(&mut runner).unwrap().current());
    for harm in fixed.into_iter().chain(any) {
        let bytes = harm.to(&bytes);
        std::fs::write(&harmed, &bytes).unwrap();
        for is_read_only in [true, false] {
            match read(&harmed, is_read_only) {
                Ok((map, checkpoint)) => assert!(map == expected && checkpoint == b"12", "{harm:?}"),
                Err(error) => {
                    let message = error.to_string();
                    assert!(error.is_damage() && message.lines().count() == 1, "{harm:?}: {message}");
                    assert!(message.contains("b.store: "), "{harm:?}: {message}");
                    told += 1;
                }
            }
        }
        std::fs::write(&harmed, &bytes).unwrap();
        if let Ok(salvage) = Salvage::scan(&harmed) {
            let blocks = check_salvage(&salvage, &expected, &harm);
            recovered += usize::from(blocks * 2 > expected.block_count());
        }
    }
    assert!(told > CASES / 4 && recovered > CASES / 4, "{told} {recovered}");
}

/// Harmed files whose checksums are correct: what the fuzz target checks. `TSDFUSE_HARMS` tries more.
#[test]
fn harm_with_correct_checksums_is_told_or_makes_a_map() {
    let dir = tempfile::tempdir().unwrap();
    let (path, harmed) = (dir.path().join("a.store"), dir.path().join("b.store"));
    let (sensor, scans) = drive();
    let mut paged = new_store(&path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..2], &[1, 2]);
    drop(paged);
    let bytes = std::fs::read(&path).unwrap();
    let cases = std::env::var("TSDFUSE_HARMS").map_or(20, |cases| cases.parse().unwrap());
    let mut runner = TestRunner::deterministic();
    for _ in 0..cases {
        let harm = harm().new_tree(&mut runner).unwrap().current();
        tsdfuse_store::fuzzing::store(&harmed, &harm.to(&bytes));
    }
}

/// Compares what was recovered with the map as it was; how many blocks there are.
fn check_salvage(salvage: &Salvage, expected: &VoxelMap, harm: &Harm) -> usize {
    let map = salvage.map().unwrap();
    assert_eq!(map.integrations(), expected.integrations(), "{harm:?}");
    // What is lost is known as long as an index is left.
    if let Some((lost, lost_blocks)) = &salvage.damage().lost {
        assert_eq!(salvage.checkpoint(), Some(&b"12"[..]), "{harm:?}");
        for region in expected.regions() {
            let expected: Vec<_> = expected.blocks_of(region).collect();
            let found: Vec<_> = map.blocks_of(region).collect();
            let is_lost = lost.contains(&region);
            assert!(found.is_empty() == is_lost, "{harm:?} {region:?}");
            assert!(is_lost || found == expected, "{harm:?} {region:?}");
        }
        let all = map.block_count() as u64 + lost_blocks;
        assert_eq!(all, expected.block_count() as u64, "{harm:?}");
        assert!(*lost_blocks == 0 || !salvage.damage().places.is_empty(), "{harm:?}");
    } else {
        assert!(!salvage.damage().places.is_empty(), "{harm:?}");
    }
    map.block_count()
}

#[test]
fn a_store_without_any_index_is_recovered_region_by_region() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let (sensor, scans) = drive();
    let mut paged = new_store(&path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..12], &[12]);
    drop(paged);
    let expected = fused(Method::Raycast, &sensor, &scans[..12]);
    let mut bytes = std::fs::read(&path).unwrap();
    for page in bytes.chunks_mut(4096) {
        if page.starts_with(b"TSDFID2\n") {
            page.fill(0);
        }
    }
    std::fs::write(&path, &bytes).unwrap();
    let told = PagedMap::open(&path, LITTLE).map(drop).unwrap_err();
    assert!(
        told.to_string().ends_with("a.store: its index: its length is another"),
        "{told}"
    );
    let salvage = Salvage::scan(&path).unwrap();
    assert_eq!((salvage.checkpoint(), &salvage.damage().lost), (None, &None));
    assert!(salvage.map().unwrap() == expected);
    assert_eq!(salvage.poses(), []);
    assert_eq!(salvage.damage().places.last().unwrap(), "the trajectory is lost");
    // It can also be saved without having all of it in memory.
    let saved = dir.path().join("a.tsdf");
    salvage.save(&saved).unwrap();
    assert!(tsdfuse_io::map_file::read(&saved).unwrap() == expected);
    // Nothing tells what the voxels mean without the headers.
    bytes[..8192].fill(0);
    std::fs::write(&path, &bytes).unwrap();
    let told = Salvage::scan(&path).map(drop).unwrap_err();
    assert!(matches!(told, StoreError::Damaged { .. }), "{told}");
}
