//! Parts of maps.

use tsdfuse::{
    MapConfig, VoxelMap,
    glam::{DVec3, IVec3},
    index::BlockIndex,
    map::{Block, Voxel},
};

/// All voxels of 4³ blocks about the origin, each with its own weight.
fn full() -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    for n in 0..64 {
        let mut block = Block::EMPTY;
        for (i, voxel) in (1..).zip(&mut block.voxels) {
            voxel.weight_sum = i + 1000 * n;
        }
        let n = n as i32;
        map.insert_block(BlockIndex(IVec3::new(n & 3, n >> 2 & 3, n >> 4) - 2), block)
            .unwrap();
    }
    map
}

#[test]
fn voxels_are_kept_whose_centres_lie_in_the_box() {
    let map = full();
    // Centres at 0.025, 0.075, …: a corner on one includes it below and excludes it above.
    let (low, high) = (DVec3::new(-0.3, 0.025, -9.0), DVec3::new(0.374, 0.125, f64::INFINITY));
    let cropped = map.cropped(low, high).unwrap();
    let (mut kept, mut left) = (0, 0);
    for voxel in (-20..20).flat_map(|z| (-20..20).flat_map(move |y| (-20..20).map(move |x| IVec3::new(x, y, z)))) {
        let center = map.grid().center(voxel);
        let inside = center.cmpge(low).all() && center.cmplt(high).all();
        let expected = if inside { map.voxel(voxel) } else { Voxel::default() };
        assert_eq!(cropped.voxel(voxel), expected, "{voxel}");
        *(if expected.weight_sum > 0 { &mut kept } else { &mut left }) += 1;
    }
    assert_eq!((kept, left), (13 * 2 * 32, 40 * 40 * 40 - 13 * 2 * 32));
    assert_eq!(cropped.block_count(), 2 * 4);
}

#[test]
fn everything_is_everything_and_nothing_is_refused() {
    let map = full();
    assert!(map.cropped(DVec3::NEG_INFINITY, DVec3::INFINITY).unwrap() == map);
    assert_eq!(
        map.cropped(DVec3::splat(5.0), DVec3::splat(6.0)).unwrap().block_count(),
        0
    );
    for (low, high) in [(DVec3::ONE, DVec3::X), (DVec3::ZERO, DVec3::NAN)] {
        assert!(
            map.cropped(low, high)
                .unwrap_err()
                .to_string()
                .contains("holds nothing")
        );
    }
}
