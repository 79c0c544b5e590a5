//! The distances of a chunk: nearest sites along z, then along y, then along x.

use tsdfuse::glam::IVec3;

use super::chunks::{CHUNK, Chunks, FAR, VOXELS};
use super::lattice::{CELLS, Lattice};

const EDGE: usize = CHUNK as usize;
/// Squared distances of voxels along z.
type Column = [i16; EDGE];

/// Memory for one chunk.
#[derive(Debug)]
pub(super) struct Transform {
    /// Cells along x and along y: the chunk's, and as far as the radius around it.
    cells: usize,
    /// For each cell in x and y, the distances along z alone.
    along_z: Vec<Column>,
    /// Whether there are any.
    has_sites: Vec<bool>,
    /// For each cell in x and voxel in y, the distances in y and z.
    along_y: Vec<Column>,
    has_near: Vec<bool>,
    /// The squared distances between a voxel and a cell that is n cells after the first cell within its reach.
    between: Vec<i16>,
}

impl Transform {
    pub(super) fn new(lattice: &Lattice) -> Self {
        let reach = lattice.reach_cells();
        let cells = (CHUNK * CELLS + 2 * reach) as usize;
        let between = |n: i32| {
            // From the middle of a cell to the middle of the voxel.
            let steps = (n - reach) * lattice.cell_steps() + lattice.cell_steps() / 2 - lattice.steps / 2;
            i16::try_from(steps * steps).unwrap_or(FAR)
        };
        Self {
            cells,
            along_z: vec![[FAR; EDGE]; cells * cells],
            has_sites: vec![false; cells * cells],
            along_y: vec![[FAR; EDGE]; cells * EDGE],
            has_near: vec![false; cells],
            between: (0..2 * reach + CELLS).map(between).collect(),
        }
    }

    /// The squared distances of a chunk's voxels in steps, x slowest; `None` where all are beyond the radius.
    pub(super) fn run(&mut self, lattice: &Lattice, chunk: IVec3, chunks: &Chunks) -> Option<Box<[i16]>> {
        if !self.find_along_z(lattice, chunk, chunks) {
            return None;
        }
        self.find_along_y();
        let mut squared = self.find_along_x();
        let mut is_near = false;
        for squared in &mut squared {
            if *squared > lattice.max_squared {
                *squared = FAR;
            } else {
                is_near = true;
            }
        }
        is_near.then(|| squared.into_boxed_slice())
    }

    /// Puts in all sites within reach; whether there are any.
    fn find_along_z(&mut self, lattice: &Lattice, chunk: IVec3, chunks: &Chunks) -> bool {
        self.along_z.fill([FAR; EDGE]);
        self.has_sites.fill(false);
        let (reach, steps) = (lattice.reach_cells(), lattice.radius_steps);
        let first = chunk.truncate() * (CHUNK * CELLS) - reach;
        let bottom = chunk.z * CHUNK * lattice.steps;
        let height = CHUNK * lattice.steps;
        // As many chunks as the radius needs.
        let beside = (reach - 1) / (CHUNK * CELLS) + 1;
        let mut any = false;
        let around = || -beside..=beside;
        let neighbours = around().flat_map(|x| around().flat_map(move |y| around().map(move |z| IVec3::new(x, y, z))));
        for site in neighbours.flat_map(|offset| chunks.sites(chunk + offset)) {
            let z = site.z - bottom;
            let cell = [site.x - first.x, site.y - first.y].map(usize::try_from);
            let [Ok(x), Ok(y)] = cell else { continue };
            if x >= self.cells || y >= self.cells || z < -steps || z > height + steps {
                continue;
            }
            let at = x * self.cells + y;
            self.has_sites[at] = true;
            any = true;
            for (voxel, nearest) in (0..).zip(&mut self.along_z[at]) {
                let apart = voxel * lattice.steps + lattice.steps / 2 - z;
                let squared = (apart * apart).min(FAR.into()) as i16;
                *nearest = squared.min(*nearest);
            }
        }
        any
    }

    fn find_along_y(&mut self) {
        for x in 0..self.cells {
            let has_sites = &self.has_sites[x * self.cells..][..self.cells];
            let columns = &self.along_z[x * self.cells..][..self.cells];
            self.has_near[x] = has_sites.contains(&true);
            for (y, nearest) in self.along_y[x * EDGE..][..EDGE].iter_mut().enumerate() {
                let mut found = [FAR; EDGE];
                let window = columns[y * CELLS as usize..]
                    .iter()
                    .zip(&has_sites[y * CELLS as usize..]);
                for ((column, has_sites), &between) in window.zip(&self.between) {
                    if *has_sites {
                        relax(&mut found, column, between);
                    }
                }
                *nearest = found;
            }
        }
    }

    fn find_along_x(&self) -> Vec<i16> {
        let mut squared = vec![FAR; VOXELS];
        for (x, found) in squared.chunks_exact_mut(EDGE * EDGE).enumerate() {
            let first = x * CELLS as usize;
            for (number, &between) in self.between.iter().enumerate() {
                if self.has_near[first + number] {
                    let columns = &self.along_y[(first + number) * EDGE..][..EDGE];
                    relax(found, columns.as_flattened(), between);
                }
            }
        }
        squared
    }
}

/// The less of what was found and of what lies so much farther.
#[inline(always)]
fn relax(found: &mut [i16], others: &[i16], farther: i16) {
    for (found, other) in found.iter_mut().zip(others) {
        *found = other.saturating_add(farther).min(*found);
    }
}
