//! Free space: what rays pass through is not surface, however often it was seen there before.
//!
//! Surface that moved on leaves a shell behind, whose voxels the map takes to lie inside of something (F < 0). A ray of a later
//! scan that passes such a voxel, coming from the side that F tells to be free, and ends well behind it contradicts this; then a part of
//! both of the voxel's sums is left. F stays as it is, so that a surface that is contradicted once in a while (by a wrong pose, a wet
//! floor) does not move; one that is contradicted again and again, and seen no more, is forgotten.
//!
//! Why the side: behind a board that is thinner than a voxel there is free space, too, which rays from its other side pass.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use fearless_simd::{Level, dispatch};
use glam::{IVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::{
    agreement::{Agreement, SIGMAS_OF_RAYS},
    centers::{BLOCK_RADIUS, Centers, Row},
    gather::ROW,
    placed::Placed,
};
use crate::{
    index::{BLOCK_EDGE, BlockIndex, REGION_SHIFT, local_number},
    map::{Block, Voxel, VoxelMap, WEIGHT_SCALE},
    memory::Hint,
    patch::Patch,
    scan::Scan,
    sensor::{Projection, ScanImage, SensorModel, approx::atan2_f32},
};

/// A voxel is inside of something if it is at least this far behind its surface, in voxels.
pub const INSIDE: f32 = 0.2;

/// A ray passes a voxel if it is at most this far from its centre, in voxels.
pub const BESIDE: f32 = 0.6;

/// A ray tells nothing about voxels nearer than this to its end, or to the plane that it ends on, in voxels: pose and range are not
/// known more precisely.
pub const MARGIN: f32 = 2.5;

/// A voxel whose weight falls below this is reset: 1/100, a return at 100 m.
pub const FORGOTTEN: u32 = WEIGHT_SCALE / 100;

/// A block is examined in one of this many scans: the first if the scan did not update it, the second if it did.
pub const TURNS: [u32; 2] = [2, 6];

/// Sums that are contradicted are divided by this.
pub const LEFT: i32 = 16;

/// If rays pass this many inside voxels of a block that the scan did not update, the whole block fades.
pub const MIN_PASSED: usize = 5;

/// Bins of elevation, per radian.
pub const BINS_PER_RAD: f32 = 1000.0;

/// What a scan saw, to tell where its rays passed.
pub(super) struct Seen<'a> {
    image: &'a ScanImage,
    placed: &'a Placed,
    patches: &'a [Patch],
    /// In the axes of the sensor at the time of the scan's pose.
    centers: Centers,
    /// If the sensor moved: in its axes when each column was measured; `None` for columns without returns.
    columns: Vec<Option<Centers>>,
    /// How far it can be off.
    agreement: Agreement,
}

impl<'a> Seen<'a> {
    pub(super) fn new(
        scan: &Scan,
        image: &'a ScanImage,
        placed: &'a Placed,
        patches: &'a [Patch],
        centers: Centers,
        agreement: Agreement,
    ) -> Self {
        let mut columns = Vec::new();
        if let (Some(sweep), Some(times)) = (scan.sweep(), &scan.times) {
            let columns_there = (0..image.columns()).into_par_iter();
            let then = columns_there.map(|column| {
                let i = (0..image.rings()).find_map(|ring| image.get(ring, column))?;
                let (rotation, shift) = sweep.relative_at(f64::from(times[i]));
                Some(Centers {
                    rotation: Mat3::from_quat(rotation.inverse().as_quat()),
                    origin: shift.as_vec3(),
                    ..centers
                })
            });
            columns = then.collect();
        }
        Self {
            image,
            placed,
            patches,
            centers,
            columns,
            agreement,
        }
    }

    /// As the sensor sees blocks at the moment of a column; `None` where no ray came back.
    #[inline(always)]
    fn centers_at(&self, column: usize) -> Option<&Centers> {
        match self.columns.as_slice() {
            [] => Some(&self.centers),
            columns => columns[column % columns.len()].as_ref(),
        }
    }
}

/// A block that may be carved.
#[derive(Clone, Copy)]
struct Examined {
    index: BlockIndex,
    slot: u32,
    is_updated: bool,
    /// The column at which the sensor turns to it.
    column: usize,
}

/// Keeps its buffers from scan to scan.
#[derive(Debug, Default)]
pub(super) struct Carver {
    /// The sensor's, and the nearest ring of each bin of elevation.
    elevations_deg: Vec<f32>,
    rings: Vec<u16>,
}

impl Carver {
    /// Fades what the rays of a scan contradict; to be called after its surface was fused. Tells which blocks changed that
    /// the scan has not updated.
    pub(super) fn carve(&mut self, map: &mut VoxelMap, seen: &Seen<'_>, sensor: &SensorModel) -> Vec<BlockIndex> {
        self.measure(sensor);
        let this = &*self;
        let config = *map.config();
        let inside = INSIDE * (config.voxel_size_m / config.truncation_m) as f32;
        let stamp = map.integrations();
        let level = Level::new(); // the vector instructions of this CPU
        let farthest2 = seen
            .placed
            .points
            .par_iter()
            .map(|p| p.length_squared())
            .reduce(|| 0.0, f32::max);
        let farthest = farthest2.sqrt();
        let region_m = (1 << REGION_SHIFT) as f32 * seen.centers.voxel_size_m;
        let carved: Vec<Vec<BlockIndex>> = map
            .shards
            .par_iter_mut()
            .map(|shard| {
                let near = |region: IVec3| {
                    let middle = seen.centers.anchor.offset_of(region << REGION_SHIFT) + 0.5 * region_m;
                    middle.length() < farthest + region_m
                };
                let has_turn = |block: &Examined| {
                    let turns = TURNS[usize::from(block.is_updated)];
                    let number = block.index.0.element_sum() as u32;
                    number.wrapping_add(stamp).is_multiple_of(turns)
                };
                let blocks = shard.blocks_of(stamp, near).map(|(index, slot, is_updated)| Examined {
                    index,
                    slot,
                    is_updated,
                    column: 0,
                });
                let mut blocks: Vec<Examined> = blocks.filter(has_turn).collect();
                dispatch!(level, _ => this.keep_passed(&mut blocks, seen));
                let mut carved = Vec::new();
                for (k, block) in blocks.iter().enumerate() {
                    let next = blocks.get(k + 1).unwrap_or(block);
                    let next = Hint::of(&shard.blocks()[next.slot as usize].voxels);
                    let voxels = &mut shard.blocks_mut()[block.slot as usize];
                    if dispatch!(level, _ => this.carve_block(block, voxels, next, seen, inside)) && !block.is_updated {
                        carved.push(block.index);
                    }
                }
                carved
            })
            .collect();
        carved.concat()
    }

    /// Fills the table of rings.
    fn measure(&mut self, sensor: &SensorModel) {
        if self.elevations_deg == sensor.elevations_deg {
            return;
        }
        self.elevations_deg.clone_from(&sensor.elevations_deg);
        self.rings = nearest_rings(sensor);
    }

    /// Bins of elevation and columns in which eight places are seen (sensor axes).
    #[inline(always)]
    fn cells([x, y, z]: &Row, columns: usize) -> ([i32; ROW], [i32; ROW]) {
        let (mut bins, mut firings) = ([0; ROW], [0; ROW]);
        let per_rad = columns as f32 / TAU;
        for i in 0..ROW {
            let elevation = atan2_f32(z[i], (x[i] * x[i] + y[i] * y[i]).sqrt());
            let column = -atan2_f32(y[i], x[i]) * per_rad;
            let column = if column < 0.0 { column + columns as f32 } else { column };
            // Not negative, so that conversion is the floor.
            bins[i] = ((elevation + FRAC_PI_2) * BINS_PER_RAD + 0.5) as i32;
            firings[i] = column as i32;
        }
        (bins, firings)
    }

    #[inline(always)]
    fn ring(&self, bin: i32) -> usize {
        usize::from(self.rings[(bin as usize).min(self.rings.len() - 1)])
    }

    /// Keeps those of some blocks that the ray nearest to their middle ends behind. Eight at a time.
    #[inline(always)]
    fn keep_passed(&self, blocks: &mut Vec<Examined>, seen: &Seen<'_>) {
        let columns = seen.image.columns();
        let mut kept = 0;
        for first in (0..blocks.len()).step_by(ROW) {
            let eight = first..(first + ROW).min(blocks.len());
            let (mut middles, mut far2) = ([Vec3::ZERO; ROW], [f32::INFINITY; ROW]);
            if !seen.columns.is_empty() {
                for (middle, block) in middles.iter_mut().zip(&blocks[eight.clone()]) {
                    *middle = seen.centers.of_block(block.index);
                }
                let (_, at) = Self::cells(&row_of(&middles), columns);
                for (block, column) in blocks[eight.clone()].iter_mut().zip(at) {
                    block.column = column as usize;
                }
            }
            for (lane, block) in blocks[eight.clone()].iter().enumerate() {
                if let Some(centers) = seen.centers_at(block.column) {
                    middles[lane] = centers.of_block(block.index);
                    let far_m = middles[lane].length() + BLOCK_RADIUS * centers.voxel_size_m;
                    far2[lane] = far_m * far_m;
                }
            }
            let (bins, at) = Self::cells(&row_of(&middles), columns);
            for (lane, number) in eight.enumerate() {
                let near = seen.image.get(self.ring(bins[lane]), at[lane] as usize % columns);
                let is_passed =
                    near.is_some_and(|i| (seen.placed.points[i] - seen.placed.origin(i)).length_squared() > far2[lane]);
                blocks[kept] = blocks[number];
                kept += usize::from(is_passed);
            }
        }
        blocks.truncate(kept);
    }

    /// Carves a whole block if the scan did not update it, else voxels of it, that are `inside` by this much in units of F; tells whether any
    /// changed. `next` is fetched from memory meanwhile.
    #[inline(always)]
    fn carve_block(
        &self,
        examined: &Examined,
        block: &mut Block,
        next: Hint<Voxel>,
        seen: &Seen<'_>,
        inside: f32,
    ) -> bool {
        let (index, whole) = (examined.index, !examined.is_updated);
        let Some(centers) = seen.centers_at(examined.column) else {
            return false;
        };
        // One bit a voxel.
        let mut passed = [0_u8; (BLOCK_EDGE * BLOCK_EDGE) as usize];
        let mut count = 0;
        let first = seen.centers.anchor.offset_of(index.first_voxel());
        let rows = centers.rows(index);
        for row in 0..BLOCK_EDGE * BLOCK_EDGE {
            let (y, z) = (row % BLOCK_EDGE, row / BLOCK_EDGE);
            let start = ROW * row as usize;
            next.prefetch(start);
            let row = &block.voxels[start..start + ROW];
            // The sign of the sum is that of F.
            if row.iter().fold(0, |signs, voxel| signs | voxel.distance_sum) >= 0 {
                continue;
            }
            let mut deep = 0;
            for (x, voxel) in row.iter().enumerate() {
                // Also false where nothing was observed.
                let is_deep = (voxel.distance_sum as f32) < -inside * voxel.weight_sum as f32;
                deep |= u32::from(is_deep) << x;
            }
            if deep == 0 {
                continue;
            }
            let (bins, columns) = Self::cells(&rows.at(y, z), seen.image.columns());
            for x in (0..ROW).filter(|x| deep >> x & 1 == 1) {
                let place = first + IVec3::new(x as i32, y, z).as_vec3() * seen.centers.voxel_size_m;
                let Some(rest) = ray_past(place, self.ring(bins[x]), columns[x] as usize, seen) else {
                    continue;
                };
                let gradient = gradient_at(block, IVec3::new(x as i32, y, z));
                if -gradient.dot(rest.way) < rest.least_m * gradient.length() {
                    continue;
                }
                passed[start / ROW] |= 1 << x;
                count += 1;
                if whole && count == MIN_PASSED {
                    block.voxels.iter_mut().for_each(fade);
                    return true;
                }
            }
        }
        if whole || count == 0 {
            return false;
        }
        for (row, passed) in block.voxels.chunks_exact_mut(ROW).zip(passed) {
            let passed = row.iter_mut().enumerate().filter(|(x, _)| passed >> x & 1 == 1);
            passed.for_each(|(_, voxel)| fade(voxel));
        }
        true
    }
}

/// The coordinates of eight places.
#[inline(always)]
fn row_of(places: &[Vec3; ROW]) -> Row {
    [0, 1, 2].map(|axis| places.map(|place| place[axis]))
}

/// The nearest ring of each bin of elevation.
pub fn nearest_rings(sensor: &SensorModel) -> Vec<u16> {
    let projection = Projection::new(sensor);
    let nearest = |bin: usize| {
        let elevation = bin as f64 / f64::from(BINS_PER_RAD) - std::f64::consts::FRAC_PI_2;
        projection
            .row_of(elevation)
            .round()
            .clamp(0.0, (sensor.rings() - 1) as f64) as u16
    };
    (0..=(PI * BINS_PER_RAD) as usize).map(nearest).collect()
}

/// The direction in which F grows at a voxel of a block, by differences to its neighbours in the block that were observed.
fn gradient_at(block: &Block, at: IVec3) -> Vec3 {
    let distance = |at: IVec3| {
        let is_here = at.cmpge(IVec3::ZERO).all() && at.cmplt(IVec3::splat(BLOCK_EDGE)).all();
        is_here.then(|| block.voxels[local_number(at)])?.distance()
    };
    let here = distance(at).unwrap_or(0.0);
    // Of two differences the sum; of one, twice: all axes alike.
    let slope = |step: IVec3| match [distance(at - step), distance(at + step)] {
        [Some(before), Some(after)] => after - before,
        [Some(before), None] => 2.0 * (here - before),
        [None, Some(after)] => 2.0 * (after - here),
        [None, None] => 0.0,
    };
    Vec3::new(slope(IVec3::X), slope(IVec3::Y), slope(IVec3::Z))
}

/// What is left of a ray that passes a place.
struct Rest {
    /// From the place to the ray's end.
    way: Vec3,
    /// How far behind a surface it must end, metres.
    least_m: f32,
}

/// The ray that passes a place, seen in a ring and between a column and the next, and ends well behind it.
#[inline(always)]
fn ray_past(place: Vec3, ring: usize, column: usize, seen: &Seen<'_>) -> Option<Rest> {
    let columns = seen.image.columns();
    let voxel_m = seen.centers.voxel_size_m;
    let radius = BESIDE * voxel_m;
    for column in [column, column + 1] {
        let Some(i) = seen.image.get(ring, column % columns) else {
            continue;
        };
        let origin = seen.placed.origin(i);
        let (end, place) = (seen.placed.points[i] - origin, place - origin);
        let length = end.length();
        let along = place.dot(end) / length;
        let beside2 = (place - end * (along / length)).length_squared();
        // Most rays pass farther away.
        if !(along > 0.0 && length - along > MARGIN * voxel_m && beside2 < radius * radius) {
            continue;
        }
        let patch = &seen.patches[i];
        let (above, sigma) = if patch.is_plane() {
            ((place - end).dot(patch.normal), seen.agreement.sigma_of(patch))
        } else {
            (length - along, seen.agreement.sigma_vox(length))
        };
        let margin = (MARGIN + SIGMAS_OF_RAYS * sigma) * voxel_m;
        if length - along > margin && above > margin {
            return Some(Rest {
                way: end - place,
                least_m: margin,
            });
        }
    }
    None
}

/// Leaves a part of both sums.
fn fade(voxel: &mut Voxel) {
    *voxel = Voxel {
        weight_sum: voxel.weight_sum / LEFT as u32,
        distance_sum: voxel.distance_sum / LEFT,
    };
    if voxel.weight_sum < FORGOTTEN {
        *voxel = Voxel::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Pose,
        fuse::depth::world_axes,
        index::Grid,
        map::testing::map_of,
        scan::PoseAt,
        sensor::{model, testing::scan_room},
    };

    /// Which blocks the rays of a scan of a room pass: eight at a time, and literally.
    fn check(motion: Vec<PoseAt>) {
        let (sensor, grid) = (model("os1-64").unwrap(), Grid::new(0.05));
        let (points, rings) = scan_room(&sensor, |_| 0.0);
        let secs = |i: usize| 0.1 * i as f32 / points.len() as f32;
        let scan = Scan {
            times: Some((0..points.len()).map(secs).collect()),
            rings: Some(rings),
            pose: Some(Pose::IDENTITY),
            motion,
            points,
            ..Scan::default()
        };
        let (mut image, mut placed) = (ScanImage::new(), Placed::default());
        image.update(&scan.points, scan.rings.as_ref().unwrap(), &sensor);
        let centers = Centers {
            anchor: placed.place(grid, &scan).unwrap(),
            origin: Vec3::ZERO,
            rotation: world_axes(&scan).unwrap().transpose(),
            voxel_size_m: 0.05,
        };
        let mut carver = Carver::default();
        carver.measure(&sensor);
        let seen = Seen::new(&scan, &image, &placed, &[], centers, Agreement::default());
        let cube = -12..12;
        let blocks = cube
            .clone()
            .flat_map(|z| cube.clone().map(move |x| IVec3::new(x, z / 2, z)));
        let examined = |index| Examined {
            index: BlockIndex(index),
            slot: 0,
            is_updated: false,
            column: 0,
        };
        let mut passed: Vec<Examined> = blocks.map(examined).collect();
        let all = passed.clone();
        dispatch!(Level::new(), _ => carver.keep_passed(&mut passed, &seen));
        let cell = |p: Vec3| {
            let (bins, columns) = Carver::cells(&[[p.x; ROW], [p.y; ROW], [p.z; ROW]], image.columns());
            (carver.ring(bins[0]), columns[0] as usize % image.columns())
        };
        let literal = all.iter().filter(|block| {
            let column = cell(centers.of_block(block.index)).1;
            let then = if seen.columns.is_empty() {
                Some(centers)
            } else {
                seen.columns[column]
            };
            then.is_some_and(|then| {
                let p = then.of_block(block.index);
                let (ring, column) = cell(p);
                let far_m = p.length() + BLOCK_RADIUS * 0.05;
                let length = |i: usize| (placed.points[i] - placed.origin(i)).length();
                image.get(ring, column).is_some_and(|i| length(i) > far_m)
            })
        });
        let literal: Vec<BlockIndex> = literal.map(|block| block.index).collect();
        let passed: Vec<BlockIndex> = passed.iter().map(|block| block.index).collect();
        assert!(
            passed == literal && literal.len() > 50 && literal.len() < all.len(),
            "{}",
            literal.len()
        );
    }

    /// A map of one plane 20 m ahead, seen often, and the same after rays without planes have passed it for some scans.
    fn carved(height_m: impl Fn(Vec3) -> f32, end: impl Fn(Vec3) -> Vec3) -> [VoxelMap; 2] {
        let mut map = map_of(IVec3::new(45, -2, -4), IVec3::new(55, 2, 0), height_m);
        let before = map.clone();
        let elevations: Vec<f32> = (0..32).map(|ring| -6.0 + 0.18 * ring as f32).collect();
        let sensor = SensorModel::from_beams("sparse", elevations, 2048, (0.1, 100.0)).unwrap();
        let beams = (0..32_u16).flat_map(|ring| (-16..16).map(move |column| (ring, column)));
        let ray = |(ring, column): (u16, i32)| {
            let (up, left) = (
                sensor.elevations_deg[usize::from(ring)].to_radians(),
                (column as f32 + 0.5) * TAU / 2048.0,
            );
            Vec3::new(up.cos() * left.cos(), up.cos() * left.sin(), up.sin())
        };
        let scan = Scan {
            points: beams.clone().map(|beam| end(ray(beam))).collect(),
            rings: Some(beams.map(|(ring, _)| ring).collect()),
            pose: Some(Pose::IDENTITY),
            ..Scan::default()
        };
        let (mut image, mut placed, mut carver) = (ScanImage::new(), Placed::default(), Carver::default());
        image.update(&scan.points, scan.rings.as_ref().unwrap(), &sensor);
        let centers = Centers {
            anchor: placed.place(map.grid(), &scan).unwrap(),
            origin: Vec3::ZERO,
            rotation: Mat3::IDENTITY,
            voxel_size_m: 0.05,
        };
        let patches: Vec<Patch> = (scan.points.iter())
            .map(|&center| Patch {
                center,
                ..Patch::default()
            })
            .collect();
        let seen = Seen::new(&scan, &image, &placed, &patches, centers, Agreement::default());
        for _ in 0..24 {
            map.begin_integration();
            carver.carve(&mut map, &seen, &sensor);
        }
        [before, map]
    }

    /// Voxels behind the surface.
    fn inside(map: &VoxelMap) -> usize {
        let blocks = map.block_indices().into_iter().filter_map(|block| map.block(block));
        blocks
            .flat_map(|block| &block.voxels)
            .filter(|voxel| voxel.distance_sum < 0)
            .count()
    }

    #[test]
    fn a_road_just_above_where_far_rays_end_stays() {
        let road = |place: Vec3| place.z + 0.7;
        // They pass less than 2 cm above it for half a metre.
        let [before, after] = carved(road, |ray| ray * (0.71 / -ray.z));
        assert!(before == after && inside(&before) > 5000);
        // And the test would see what is erased: rays that end half a metre deeper.
        let [before, after] = carved(road, |ray| ray * (1.2 / -ray.z));
        assert!(2 * inside(&after) < inside(&before), "{}", inside(&after));
    }

    #[test]
    fn a_wall_that_rays_end_behind_goes() {
        let wall = |place: Vec3| 20.0 - place.x;
        let [before, after] = carved(wall, |ray| ray * (21.0 / ray.x));
        assert!(
            inside(&after) < inside(&before) / 2,
            "{} of {}",
            inside(&after),
            inside(&before)
        );
        // Not if they end on it.
        let [before, after] = carved(wall, |ray| ray * (20.01 / ray.x));
        assert!(before == after);
    }

    #[test]
    fn blocks_that_rays_pass_are_found_eight_at_a_time() {
        check(Vec::new());
        check(vec![PoseAt {
            secs: 0.1,
            pose: Pose {
                translation: glam::DVec3::new(0.5, 0.2, 0.0),
                ..Pose::IDENTITY
            },
        }]);
    }
}
