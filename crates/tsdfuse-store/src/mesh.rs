//! The surface of a whole map, of which only a part is in memory at a time.
//!
//! The map is meshed tile by tile, each with one block more on all sides, so that a tile's blocks find their neighbours; which of
//! the pieces of a tile are its own, their first corner decides. A vertex is worked out by every piece that has it, with the same bits
//! ([`tsdfuse::mesh::Piece`]), so its position tells which ones are one. Only those on the border between tiles have to be
//! remembered from tile to tile.

use std::io;

use hashbrown::HashMap;
use rustc_hash::FxBuildHasher;
use tsdfuse::VoxelMap;
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::index::{BlockIndex, Grid, RegionIndex};
use tsdfuse::mesh::{Changes, Incremental, MeshConfig, Piece};

use crate::error::Result;
use crate::pager::Pager;

/// Regions along the edge of a tile: 12.8 m at 5 cm.
const TILE: i32 = 4;

/// Blocks along the edge of a tile, as a shift.
const TILE_SHIFT: u32 = 5;

/// Who takes a mesh, part by part.
pub trait Sink {
    /// Takes vertices that come next (world, metres), with their normals.
    ///
    /// # Errors
    /// What keeps it from that.
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> io::Result<()>;

    /// Takes triangles between vertices that came before, numbered from 0 through all parts.
    ///
    /// # Errors
    /// What keeps it from that.
    fn triangles(&mut self, triangles: &[[u32; 3]]) -> io::Result<()>;
}

type Numbers = HashMap<[u64; 3], u32, FxBuildHasher>;

impl Pager {
    /// Extracts the surface of the whole map, which is the one of [`tsdfuse::mesh::extract_with`], its vertices and triangles in another
    /// order. There is no more of the map in memory than else.
    ///
    /// # Errors
    /// As [`Pager::bring`], and what `sink` says; also for more than 2³² vertices.
    pub fn mesh(&mut self, map: &mut VoxelMap, config: &MeshConfig, sink: &mut impl Sink) -> Result<()> {
        let mut tiles: Vec<IVec3> = self.regions().iter().map(|region| tile_of(*region)).collect();
        tiles.sort_unstable_by_key(|tile| (tile.z, tile.y, tile.x));
        tiles.dedup();
        let mut stitcher = Stitcher::new(map.grid());
        let mut changes = Changes::default();
        for tile in tiles {
            self.bring_all(map, &about(tile))?;
            self.release(map)?;
            let mut surface = Incremental::new(config);
            let regions = about(tile).into_iter();
            let blocks: Vec<BlockIndex> = regions
                .flat_map(|region| map.blocks_of(region).map(|(index, _)| index).collect::<Vec<_>>())
                .filter(|&index| is_near(index, tile))
                .collect();
            surface.note(&blocks);
            surface.changes(map, &mut changes);
            for piece in changes.iter().filter(|piece| piece.block.0 >> TILE_SHIFT == tile) {
                stitcher.add(&piece)?;
            }
            stitcher.finish_tile(sink)?;
        }
        Ok(())
    }
}

fn tile_of(RegionIndex(region): RegionIndex) -> IVec3 {
    region.div_euclid(IVec3::splat(TILE))
}

/// The regions of a tile and those beside it.
fn about(tile: IVec3) -> Vec<RegionIndex> {
    let first = tile * TILE - 1;
    let edge = || 0..TILE + 2;
    let all = edge().flat_map(|z| edge().flat_map(move |y| edge().map(move |x| IVec3::new(x, y, z))));
    all.map(|offset| RegionIndex(first + offset)).collect()
}

/// Whether a block lies in a tile or beside it.
fn is_near(BlockIndex(block): BlockIndex, tile: IVec3) -> bool {
    let first = tile << TILE_SHIFT;
    block.cmpge(first - 1).all() && block.cmple(first + (1 << TILE_SHIFT)).all()
}

/// Puts pieces together.
struct Stitcher {
    grid: Grid,
    /// Of vertices that other tiles may have, too; and of this tile's other ones.
    shared: Numbers,
    own: Numbers,
    count: u32,
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Stitcher {
    fn new(grid: Grid) -> Self {
        Self {
            grid,
            shared: Numbers::default(),
            own: Numbers::default(),
            count: 0,
            positions: Vec::new(),
            normals: Vec::new(),
            triangles: Vec::new(),
        }
    }

    fn add(&mut self, piece: &Piece<'_>) -> Result<()> {
        let mut numbers = Vec::with_capacity(piece.vertices.len());
        for (&position, &normal) in piece.vertices.iter().zip(piece.normals) {
            let key = position.to_array().map(f64::to_bits);
            let known = match self.is_shared(position) {
                true => &mut self.shared,
                false => &mut self.own,
            };
            let number = *known.entry(key).or_insert_with(|| {
                self.positions.push(position);
                self.normals.push(normal);
                self.count += 1;
                self.count - 1
            });
            numbers.push(number);
        }
        if self.count > u32::MAX - (1 << 20) {
            return Err(io::Error::other("the surface has more vertices than one mesh can number").into());
        }
        let number = |v: u32| numbers.get(v as usize).copied().unwrap_or_default();
        self.triangles
            .extend(piece.triangles.iter().map(|corners| corners.map(number)));
        Ok(())
    }

    /// Whether a vertex lies on the plane through the first voxel centres of a tile.
    fn is_shared(&self, position: DVec3) -> bool {
        /// Less than vertices keep from voxel centres.
        const SLACK: f64 = 1e-4;
        let in_voxels = position / self.grid.voxel_size_m() - 0.5 + SLACK;
        let voxel = in_voxels.floor().as_i64vec3();
        voxel.to_array().iter().any(|v| v & ((8 << TILE_SHIFT) - 1) == 0)
    }

    fn finish_tile(&mut self, sink: &mut impl Sink) -> Result<()> {
        sink.vertices(&self.positions, &self.normals)?;
        sink.triangles(&self.triangles)?;
        self.own.clear();
        self.positions.clear();
        self.normals.clear();
        self.triangles.clear();
        Ok(())
    }
}
