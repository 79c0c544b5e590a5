//! The surface of a map, cube by cube. Only the blocks in and around one cube have to be in memory at a time.
//!
//! A cube is meshed together with one layer of blocks around it, so that its blocks find their neighbours. The first
//! corner of a cell decides which cube the cell belongs to.
//!
//! ```
//! use tsdfuse::{Integrator, MapConfig, Raycast, Scan, VoxelMap, glam::Vec3, mesh};
//! let points = (-20..=20).flat_map(|y| (-20..=20).map(move |z| Vec3::new(1.0, 0.02 * y as f32, 0.02 * z as f32)));
//! let mut map = VoxelMap::new(MapConfig::default())?;
//! Raycast::default().integrate(&mut map, &Scan { points: points.collect(), ..Default::default() })?;
//! let mut surface = mesh::Surface::new(&map, &mesh::MeshConfig::default());
//! let mut triangles = 0;
//! for cube in surface.cubes() {
//!     triangles += surface.pieces(cube)?.map(|piece| piece.triangles.len()).sum::<usize>();
//! }
//! assert_eq!(triangles, mesh::extract(&map)?.triangles.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::fmt::Debug;
use std::io;

use glam::{DVec3, IVec3};

use super::{
    MeshConfig,
    changes::{Changes, Piece},
    incremental::Incremental,
};
use crate::{
    index::{BlockIndex, Grid, RegionIndex},
    map::VoxelMap,
};

/// Regions along the edge of a cube: 12.8 m for voxels of 5 cm.
const CUBE: i32 = 4;

/// Blocks along the edge of a cube, as a shift.
const CUBE_SHIFT: u32 = 5;

/// Voxels along the edge of a cube.
pub const CUBE_VOXELS: i32 = 8 << CUBE_SHIFT;

/// A map whose regions can be loaded when they are needed. A whole [`VoxelMap`] has all of them in memory.
pub trait RegionSource: Debug {
    /// The part of the map that is in memory.
    fn map(&self) -> &VoxelMap;

    /// The regions of the whole map, sorted.
    fn regions(&self) -> Vec<RegionIndex>;

    /// Loads these regions, as far as they exist. Returns whether other regions may have been evicted or loaded.
    ///
    /// # Errors
    /// If the regions cannot be read.
    fn load(&mut self, regions: &[RegionIndex]) -> io::Result<bool>;
}

impl RegionSource for &VoxelMap {
    fn map(&self) -> &VoxelMap {
        self
    }

    fn regions(&self) -> Vec<RegionIndex> {
        VoxelMap::regions(self)
    }

    fn load(&mut self, _: &[RegionIndex]) -> io::Result<bool> {
        Ok(false)
    }
}

/// The surface of a map, cube by cube. Together, the pieces of all cubes are the mesh of [`super::extract_with`].
#[derive(Debug)]
pub struct Surface<'a> {
    source: Box<dyn RegionSource + 'a>,
    config: MeshConfig,
    surface: Incremental,
    changes: Changes,
}

impl<'a> Surface<'a> {
    /// The surface of a map. Nothing is extracted yet.
    pub fn new(source: impl RegionSource + 'a, config: &MeshConfig) -> Self {
        Self {
            source: Box::new(source),
            config: *config,
            surface: Incremental::new(config),
            changes: Changes::default(),
        }
    }

    /// What is extracted.
    pub fn config(&self) -> &MeshConfig {
        &self.config
    }

    /// The map's voxel grid.
    pub fn grid(&self) -> Grid {
        self.source.map().grid()
    }

    /// The cubes that can contain surface, sorted by z, y, x. Cube c begins at voxel c · [`CUBE_VOXELS`].
    pub fn cubes(&self) -> Vec<IVec3> {
        let cube_of = |region: RegionIndex| region.0.div_euclid(IVec3::splat(CUBE));
        let mut cubes: Vec<IVec3> = self.source.regions().into_iter().map(cube_of).collect();
        cubes.sort_unstable_by_key(|cube| (cube.z, cube.y, cube.x));
        cubes.dedup();
        cubes
    }

    /// The pieces of a cube, sorted by block.
    ///
    /// # Errors
    /// As [`RegionSource::load`].
    pub fn pieces(&mut self, cube: IVec3) -> io::Result<impl Iterator<Item = Piece<'_>>> {
        let regions = regions_around(cube);
        if self.source.load(&regions)? {
            // Signs of blocks that have left memory are of no use.
            self.surface = Incremental::new(&self.config);
        }
        let map = self.source.map();
        let near = |region| {
            let all = map.blocks_of(region).map(|(index, _)| index);
            all.filter(|index| is_near(*index, cube)).collect::<Vec<_>>()
        };
        let blocks: Vec<BlockIndex> = regions.into_iter().flat_map(near).collect();
        self.surface.note(&blocks);
        self.surface.changes(map, &mut self.changes);
        let own = move |piece: &Piece<'_>| piece.block.0 >> CUBE_SHIFT == cube;
        Ok(self.changes.iter().filter(own))
    }
}

/// Whether a vertex lies on one of the planes through the centres of voxels 0, ±n, ±2n, …, for n a power of two. At
/// these planes the cells of blocks that begin there meet the cells of the blocks before.
pub fn is_on_plane(grid: Grid, vertex: DVec3, n: i64) -> bool {
    /// Less than the distance that vertices keep from voxel centres, more than the rounding error.
    const SLACK: f64 = 1e-4;
    let in_voxels = vertex / grid.voxel_size_m() - 0.5;
    let (nearest, far) = (in_voxels.round().as_i64vec3(), (in_voxels - in_voxels.round()).abs());
    let on = |axis: usize| far[axis] < SLACK && nearest[axis] & (n - 1) == 0;
    (0..3).any(on)
}

/// The regions of a cube and those around it.
fn regions_around(cube: IVec3) -> Vec<RegionIndex> {
    let first = cube * CUBE - 1;
    let edge = || 0..CUBE + 2;
    let all = edge().flat_map(|z| edge().flat_map(move |y| edge().map(move |x| IVec3::new(x, y, z))));
    all.map(|offset| RegionIndex(first + offset)).collect()
}

/// Whether a block lies in a cube or next to it.
fn is_near(BlockIndex(block): BlockIndex, cube: IVec3) -> bool {
    let first = cube << CUBE_SHIFT;
    block.cmpge(first - 1).all() && block.cmple(first + (1 << CUBE_SHIFT)).all()
}
