//! Meshing a map that grows, scan by scan: only what an update can have changed is meshed again.
//!
//! ```text
//!   updated blocks ─▶ their signs are read anew ─▶ they and their neighbours: which of them can look different?
//!                                                      └─▶ cells, edges, vertices of these alone ─▶ pieces
//! ```
//!
//! For each block, the signs of its voxels are kept, and on which of its neighbours its piece of the surface depends: 132 bytes, 3 %
//! of a block. The pieces themselves are not kept.

use fearless_simd::{Level, Simd, dispatch};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{
    Mesh, MeshConfig, MeshError,
    changes::{Changes, Chunk, Entry},
    extract::{BLOCKS_PER_TASK, extract_from},
    mesher::{Mesher, Source},
    near::{CORNERS, Finder, PerBlock},
    nearby::Nearby,
    neighbourhood::Cells,
    signs::Signs,
    updated::{Blocks, Candidate, candidates, existing, insert},
};
use crate::{
    index::{BlockIndex, REGION_SHIFT, SHARDS, shard_of_region},
    map::{Block, VoxelMap},
    memory::prefetch,
};

/// The surface of a map that is still being fused, as the pieces that changed.
///
/// Report every integration ([`Incremental::note`]), and ask for changes as often as you like: after each scan, once a second, at the end.
///
/// ```
/// use tsdfuse::{Integrator, MapConfig, Pose, Raycast, Scan, VoxelMap, glam::Vec3, mesh::{Changes, Incremental}};
/// let mut map = VoxelMap::new(MapConfig::default())?;
/// let (mut raycast, mut surface, mut changes) = (Raycast::default(), Incremental::default(), Changes::default());
/// for x in [1.0, 1.5] {
///     let points = (-20..=20).flat_map(|y| (-20..=20).map(move |z| Vec3::new(x, 0.02 * y as f32, 0.02 * z as f32)));
///     let scan = Scan { points: points.collect(), pose: Some(Pose::IDENTITY), ..Default::default() };
///     surface.note(&raycast.integrate(&mut map, &scan)?.updated_blocks);
///     surface.changes(&map, &mut changes);
///     for piece in changes.iter() {
///         // Show it in place of what this block showed before.
///         println!("{:?}: {} triangles", piece.block, piece.triangles.len());
///     }
/// }
/// assert_eq!(surface.mesh(&map)?, tsdfuse::mesh::extract(&map)?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Incremental {
    level: Level,
    min_sum: i32,
    signs: PerBlock<Signs>,
    /// On which blocks each block's piece depends: bits, as numbered in [`super::near::Near`]. 0: it has no surface.
    sources: PerBlock<u32>,
    /// Updated since signs were read.
    unread: Blocks,
    /// Updated since changes were told.
    untold: Blocks,
}

impl Default for Incremental {
    fn default() -> Self {
        Self::new(&MeshConfig::default())
    }
}

impl Incremental {
    /// For a map without blocks. For any other map, note all of its blocks first.
    pub fn new(config: &MeshConfig) -> Self {
        Self {
            level: Level::new(),
            min_sum: config.min_weight_sum(),
            signs: PerBlock::default(),
            sources: PerBlock::default(),
            unread: Blocks::default(),
            untold: Blocks::default(),
        }
    }

    /// Notes blocks that were updated: [`crate::Integration::updated_blocks`]. No work is done yet.
    pub fn note(&mut self, updated_blocks: &[BlockIndex]) {
        for &index in updated_blocks {
            insert(&mut self.unread, index);
        }
    }

    /// Replaces the contents of `changes` by the pieces that may have changed since the last call. All pieces together are the
    /// map's surface.
    ///
    /// The map must be the one whose updates were noted. Reusing the same [`Changes`] avoids allocations.
    pub fn changes(&mut self, map: &VoxelMap, changes: &mut Changes) {
        self.read(map);
        let updated = std::mem::take(&mut self.untold);
        self.tell(map, &updated, changes);
    }

    /// [`Self::changes`] for a robot: what changed far away is told in turns, by regions of 64³ voxels. [`Self::changes`] tells all that is left.
    pub fn changes_near(&mut self, map: &VoxelMap, nearby: &Nearby, changes: &mut Changes) {
        self.read(map);
        let edge_m = map.config().voxel_size_m * f64::from(1 << REGION_SHIFT);
        let due = self.untold.extract_if(|region, _| nearby.is_due(*region, edge_m));
        let due: Blocks = due.collect();
        self.tell(map, &due, changes);
    }

    /// Replaces the contents of `changes` by the pieces that these updates may have changed.
    fn tell(&mut self, map: &VoxelMap, updated: &Blocks, changes: &mut Changes) {
        let candidates = candidates(map, updated);
        let this = &*self;
        changes
            .chunks
            .resize_with(candidates.len().div_ceil(BLOCKS_PER_TASK), Chunk::default);
        let tasks = changes
            .chunks
            .par_iter_mut()
            .zip(candidates.par_chunks(BLOCKS_PER_TASK));
        tasks.enumerate().for_each_init(
            || Workplace {
                source: this.source(map),
                finder: Finder::new(map),
                mesher: Mesher::new(),
            },
            |workplace, (number, (chunk, candidates))| {
                chunk.clear();
                dispatch!(this.level, simd => for (k, candidate) in candidates.iter().enumerate() {
                    if let Some(next) = candidates.get(k + 1).filter(|next| this.sources.get(next.place) != Some(&0)) {
                        prefetch_block(next.place.block(map));
                    }
                    this.remesh(simd, workplace, number, candidate, chunk);
                });
            },
        );
        changes.entries.clear();
        for chunk in &changes.chunks {
            changes.entries.extend_from_slice(&chunk.entries);
            for &(place, sources) in &chunk.sources {
                if let Some(known) = self.sources.get_mut(place) {
                    *known = sources;
                }
            }
        }
        changes.entries.par_sort_unstable_by_key(|entry| entry.block);
    }

    /// The whole surface: what [`super::extract_with`] finds in the map, bit for bit.
    ///
    /// # Errors
    /// [`MeshError::TooManyVertices`] beyond 2³² vertices.
    pub fn mesh(&mut self, map: &VoxelMap) -> Result<Mesh, MeshError> {
        self.read(map);
        extract_from(&self.source(map), &self.signs, self.level)
    }

    /// Memory used in addition to the map, in bytes.
    pub fn memory_bytes(&self) -> usize {
        self.signs.memory_bytes()
            + self.sources.memory_bytes()
            + self.unread.allocation_size()
            + self.untold.allocation_size()
    }

    fn source<'a>(&self, map: &'a VoxelMap) -> Source<'a> {
        Source {
            map,
            min_sum: self.min_sum,
        }
    }

    /// Reads the signs of updated blocks.
    fn read(&mut self, map: &VoxelMap) {
        self.signs.grow(map, &Signs::NONE);
        self.sources.grow(map, &0);
        let mut by_shard = vec![Vec::new(); SHARDS];
        for (region, bits) in self.unread.drain() {
            by_shard[shard_of_region(region)].push((region, bits));
            let untold = self.untold.entry(region).or_default();
            let both = untold.as_flattened_mut().iter_mut().zip(bits.as_flattened());
            both.for_each(|(untold, bits)| *untold |= bits);
        }
        let shards = self.signs.shards.par_iter_mut().zip(&map.shards).zip(by_shard);
        let (level, min_sum) = (self.level, self.min_sum);
        shards.for_each(|((signs, shard), regions)| {
            dispatch!(level, simd => for (region, bits) in regions {
                let slots: Vec<usize> = existing(shard.region(region), &bits).collect();
                for (k, &slot) in slots.iter().enumerate() {
                    if let Some(&next) = slots.get(k + 1) {
                        prefetch_block(&shard.blocks()[next]);
                    }
                    signs[slot] = Signs::of(simd, &shard.blocks()[slot], min_sum);
                }
            });
        });
    }

    /// Makes the new piece of a block, if it may have changed.
    #[inline(always)]
    fn remesh<S: Simd>(
        &self,
        simd: S,
        workplace: &mut Workplace<'_>,
        number: usize,
        candidate: &Candidate,
        chunk: &mut Chunk,
    ) {
        let Workplace { source, finder, mesher } = workplace;
        let Candidate { index, place, updated } = *candidate;
        let known = self.sources.get(place).copied().unwrap_or_default();
        // A cell's corners lie in the block and in those after it: only these change which cells have surface.
        if updated & known == 0 && updated & AFTER == 0 {
            return;
        }
        let near = finder.near(index);
        if updated & known == 0 && !self.signs.may_have_surface(&near) {
            return;
        }
        mesher.load(simd, &self.signs, &near, Cells::Own);
        let sources = mesher.near.sources(simd);
        if updated & (known | sources) == 0 {
            return;
        }
        mesher.number_vertices(9, 0);
        let Mesh {
            vertices,
            normals,
            triangles,
        } = &mut chunk.mesh;
        let (first_vertex, first_triangle) = (vertices.len(), triangles.len());
        vertices.resize(first_vertex + mesher.vertex_count(), DVec3::ZERO);
        normals.resize(vertices.len(), Vec3::ZERO);
        mesher.vertices(
            simd,
            source,
            &near,
            index,
            (&mut vertices[first_vertex..], &mut normals[first_vertex..]),
        );
        mesher.for_each_triangle(|corners| triangles.push(corners));
        chunk.sources.push((place, sources));
        chunk.entries.push(Entry {
            block: index,
            chunk: number,
            vertices: first_vertex..vertices.len(),
            triangles: first_triangle..triangles.len(),
        });
    }
}

/// The working memory of one thread.
struct Workplace<'a> {
    source: Source<'a>,
    finder: Finder<'a>,
    mesher: Mesher,
}

/// [`CORNERS`] as bits.
const AFTER: u32 = {
    let (mut all, mut corner) = (0, 0);
    while corner < 8 {
        all |= 1 << CORNERS[corner];
        corner += 1;
    }
    all
};

/// Prefetches a block.
#[inline(always)]
fn prefetch_block(block: &Block) {
    block.voxels.iter().step_by(8).for_each(prefetch);
}
