//! The surface of a map, of which only a part needs to be in memory at a time.
//!
//! The map is meshed cube by cube, each with one block more on all sides, so that a cube's blocks find their neighbours; which of
//! the pieces are the cube's own, their first corner decides.

use tsdfuse::VoxelMap;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::index::{BlockIndex, Grid, RegionIndex};
use tsdfuse::mesh::{Changes, Incremental, MeshConfig, Piece};

use crate::error::Result;
use crate::pager::Pager;

/// Regions along the edge of a cube: 12.8 m at 5 cm.
const CUBE: i32 = 4;

/// Blocks along the edge of a cube, as a shift.
const CUBE_SHIFT: u32 = 5;

/// Voxels along the edge of a cube.
pub const CUBE_VOXELS: i32 = 8 << CUBE_SHIFT;

/// The surface of a map, cube by cube: all pieces together are what [`tsdfuse::mesh::extract_with`] finds.
#[derive(Debug)]
pub struct Surface<'a> {
    source: Source<'a>,
    config: MeshConfig,
    surface: Incremental,
    changes: Changes,
}

#[derive(Debug)]
enum Source<'a> {
    Whole(&'a VoxelMap),
    Paged(&'a mut VoxelMap, &'a mut Pager),
}

impl<'a> Surface<'a> {
    /// Of a map that is all in memory.
    pub fn whole(map: &'a VoxelMap, config: &MeshConfig) -> Self {
        Self::of(Source::Whole(map), config)
    }

    /// Of a map that is paged.
    pub fn paged(map: &'a mut VoxelMap, pager: &'a mut Pager, config: &MeshConfig) -> Self {
        Self::of(Source::Paged(map, pager), config)
    }

    fn of(source: Source<'a>, config: &MeshConfig) -> Self {
        Self {
            source,
            config: *config,
            surface: Incremental::new(config),
            changes: Changes::default(),
        }
    }

    /// What is extracted.
    pub fn config(&self) -> &MeshConfig {
        &self.config
    }

    /// The grid of its voxels.
    pub fn grid(&self) -> Grid {
        match &self.source {
            Source::Whole(map) => map.grid(),
            Source::Paged(map, _) => map.grid(),
        }
    }

    /// The cubes that can have surface, sorted by z, y, x: cube c begins with voxel c · [`CUBE_VOXELS`].
    pub fn cubes(&self) -> Vec<IVec3> {
        let regions = match &self.source {
            Source::Whole(map) => map.regions(),
            Source::Paged(_, pager) => pager.regions(),
        };
        let cube_of = |region: RegionIndex| region.0.div_euclid(IVec3::splat(CUBE));
        let mut cubes: Vec<IVec3> = regions.into_iter().map(cube_of).collect();
        cubes.sort_unstable_by_key(|cube| (cube.z, cube.y, cube.x));
        cubes.dedup();
        cubes
    }

    /// The pieces of a cube, in the order of their blocks. No more of a paged map is in memory than else.
    ///
    /// # Errors
    /// As [`Pager::bring`].
    pub fn pieces(&mut self, cube: IVec3) -> Result<impl Iterator<Item = Piece<'_>>> {
        if let Source::Paged(map, pager) = &mut self.source {
            pager.turn_to(map, &about(cube))?;
            // What was known of the blocks that were there before is of no use.
            self.surface = Incremental::new(&self.config);
        }
        let map = match &self.source {
            Source::Whole(map) => map,
            Source::Paged(map, _) => &**map,
        };
        let near = |region| {
            let all = map.blocks_of(region).map(|(index, _)| index);
            all.filter(|index| is_near(*index, cube)).collect::<Vec<_>>()
        };
        let blocks: Vec<BlockIndex> = about(cube).into_iter().flat_map(near).collect();
        self.surface.note(&blocks);
        self.surface.changes(map, &mut self.changes);
        let own = move |piece: &Piece<'_>| piece.block.0 >> CUBE_SHIFT == cube;
        Ok(self.changes.iter().filter(own))
    }
}

/// Whether a vertex lies on a plane through the centres of voxels 0, ±n, ±2 n, …, n being a power of two: where the cells of blocks that
/// begin there meet those of the blocks before.
pub fn is_on_plane(grid: Grid, vertex: DVec3, n: i64) -> bool {
    /// Less than vertices keep from the centres of voxels, more than what rounding does.
    const SLACK: f64 = 1e-4;
    let in_voxels = vertex / grid.voxel_size_m() - 0.5;
    let (nearest, far) = (in_voxels.round().as_i64vec3(), (in_voxels - in_voxels.round()).abs());
    let on = |axis: usize| far[axis] < SLACK && nearest[axis] & (n - 1) == 0;
    (0..3).any(on)
}

/// The regions of a cube and those beside it.
fn about(cube: IVec3) -> Vec<RegionIndex> {
    let first = cube * CUBE - 1;
    let edge = || 0..CUBE + 2;
    let all = edge().flat_map(|z| edge().flat_map(move |y| edge().map(move |x| IVec3::new(x, y, z))));
    all.map(|offset| RegionIndex(first + offset)).collect()
}

/// Whether a block lies in a cube or beside it.
fn is_near(BlockIndex(block): BlockIndex, cube: IVec3) -> bool {
    let first = cube << CUBE_SHIFT;
    block.cmpge(first - 1).all() && block.cmple(first + (1 << CUBE_SHIFT)).all()
}
