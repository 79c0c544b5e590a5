//! Regions out of maps and back in.

use tsdfuse::{
    MapConfig, VoxelMap,
    glam::IVec3,
    index::{BlockIndex, RegionIndex},
    map::{Block, MapError, RegionBlocks, Voxel},
};

fn block(mark: u32) -> Block {
    let mut block = Block::EMPTY;
    block.voxels[5] = Voxel {
        weight_sum: mark + 1,
        distance_sum: 0,
    };
    block
}

/// Two regions, in turns, in an order that is not that of the blocks.
fn map(blocks: u32) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    for n in 0..blocks {
        let at = (n * 37 % 512) as i32;
        let index = BlockIndex(IVec3::new(at & 7, at >> 3 & 7, at >> 6));
        map.insert_block(index, block(n)).unwrap();
        map.insert_block(BlockIndex(index.0 - 8), block(1000 + n)).unwrap();
    }
    map
}

#[test]
fn a_region_goes_out_and_comes_back_with_its_memory() {
    for blocks in [1, 7, 8, 9, 100, 512] {
        let (whole, mut map) = (map(blocks), map(blocks));
        let index = RegionIndex(IVec3::splat(-1));
        assert_eq!(map.regions(), [index, RegionIndex(IVec3::ZERO)]);
        let (first, _) = map.blocks_of(index).next().unwrap();
        let at = std::ptr::from_ref(map.block(first).unwrap());
        let before = map.memory_bytes();
        let region = map.take_region(index).unwrap();
        assert!(map.take_region(index).is_none() && map.block(first).is_none() && map != whole);
        assert_eq!(
            (region.index(), region.block_count(), map.block_count()),
            (index, blocks as usize, blocks as usize)
        );
        assert!(before - map.memory_bytes() >= blocks as usize * 4096);
        let of_whole: Vec<_> = whole.blocks_of(index).collect();
        let mut of_region: Vec<_> = region.blocks().collect();
        of_region.sort_unstable_by_key(|(index, _)| *index);
        assert!(of_region == of_whole);
        map.put_region(region).unwrap();
        assert!(map == whole && std::ptr::eq(map.block(first).unwrap(), at));
        // It can grow as if it had stayed.
        let mut grown = whole.clone();
        for map in [&mut map, &mut grown] {
            for n in blocks..512 {
                let at = (n * 37 % 512) as i32;
                let index = IVec3::new(at & 7, at >> 3 & 7, at >> 6) - 8;
                map.insert_block(BlockIndex(index), block(n)).unwrap();
            }
        }
        assert!(map == grown);
    }
}

#[test]
fn regions_are_made_elsewhere_and_put_in_once() {
    let mut map = map(20);
    let whole = map.clone();
    let taken = map.take_region(RegionIndex(IVec3::ZERO)).unwrap();
    let mut made = RegionBlocks::new(taken.index(), &map.pool());
    for (index, block) in taken.blocks() {
        made.insert(index, block).unwrap();
    }
    let (index, _) = taken.blocks().next().unwrap();
    let told = |e: Result<(), MapError>| e.unwrap_err().to_string();
    assert!(told(made.insert(index, &block(1))).contains("is there already"));
    assert!(told(made.insert(BlockIndex(IVec3::splat(8)), &block(1))).contains("outside"));
    assert!(told(made.insert(index, &block(u32::MAX - 1))).contains("cannot hold"));
    map.put_region(made).unwrap();
    assert!(map == whole);
    assert!(told(map.put_region(taken)).contains("is there already"));
    assert!(map == whole);
}

#[test]
fn taking_and_making_regions_again_and_again_takes_no_more_memory() {
    let mut map = map(100);
    let most = map.memory_bytes();
    for _ in 0..1000 {
        drop(map.take_region(RegionIndex(IVec3::ZERO)));
        for n in 0..100 {
            map.insert_block(BlockIndex(IVec3::new(n & 7, n >> 3 & 7, n >> 6)), block(7))
                .unwrap();
        }
        assert!(map.memory_bytes() <= most);
    }
}
