//! Surfels (S), thesis 5.5: the returns of a scan are first summed up to planar discs, and each disc updates the voxels about it.
//!
//! Which voxels: within the disc's radius of its normal through c (5.21), within μ of its plane (5.22). What distance:
//! (v − c)·n/μ (5.24), to the plane. What weight: (1 − ‖o − c‖/χ) · 1/(1 + ‖v − c‖/μ) (5.25)–(5.27), by range and by the distance
//! from the disc's centre. The discs come from [`SurfelMap`].
//!
//! Strong on large flat surfaces seen head-on: the noise of many returns is averaged, and what lies between the scan lines is
//! covered. Weak everywhere else (thesis 7.5): what is smaller than a cell is lost, discs stick out beyond edges, cells with
//! few returns leave holes, and a cell crossed by one scan line has a wrong normal. Ground seen at grazing incidence is torn,
//! since the normals of its cells turn one way or the other by their noise; `ground_flip` mends that, and spoils the walls
//! below the sensor.

use std::time::Instant;

use glam::Vec3;

use super::{
    FuseError, Integration, Integrator, Skipped,
    gather::{Gather, Near, Updates},
    placed::Placed,
};
use crate::{
    index::{BLOCK_EDGE, BlockIndex, GridPoint, round},
    map::VoxelMap,
    scan::{RangeLimits, Scan},
    sensor::{SensorModel, guess},
    surfel::{SurfelConfig, SurfelMap},
};

/// The integrator of surfels.
#[derive(Debug, Default)]
pub struct Surfels {
    config: SurfelConfig,
    max_range_m: Option<f32>,
    placed: Placed,
    surfels: SurfelMap,
    discs: Vec<Disc>,
    gather: Gather,
}

impl Surfels {
    /// With the given options. Of the sensor only its longest range counts; without a model the first scan decides which
    /// sensor it is, and if no beams show in it, the default of [`RangeLimits`] holds.
    pub fn new(config: SurfelConfig, sensor: Option<&SensorModel>) -> Self {
        Self {
            config,
            max_range_m: sensor.map(|s| s.max_range_m),
            ..Self::default()
        }
    }

    /// Makes the discs of the surfels, and counts the returns of those without.
    fn make_discs(&mut self, max_range_m: f32, voxels_per_m: f32) -> (u64, Skipped) {
        let mut fused = 0;
        let mut skipped = Skipped {
            outside_grid: self.surfels.outside(),
            without_normal: self.surfels.too_few(),
            ..Default::default()
        };
        self.discs.clear();
        for surfel in self.surfels.surfels() {
            let returns = u64::from(surfel.points);
            let weight = 1.0 - surfel.distance_m / max_range_m; // (5.26)
            let place = self.placed.anchor().and_then(|anchor| anchor.locate(surfel.center));
            match place {
                None => skipped.outside_grid += returns,
                Some(_) if !(weight > 0.0) => skipped.without_weight += returns,
                Some(center) => {
                    fused += returns;
                    self.discs.push(Disc {
                        center,
                        normal: surfel.normal,
                        radius: surfel.radius_m * voxels_per_m,
                        weight,
                    });
                }
            }
        }
        (fused, skipped)
    }
}

impl Integrator for Surfels {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        self.placed.place(map.grid(), scan)?;
        if scan.points.is_empty() {
            return Ok(Integration::default());
        }
        let max_range_m = *self.max_range_m.get_or_insert_with(|| {
            let model = guess(&scan.points, scan.rings.as_deref());
            model.map_or(RangeLimits::default().max_range_m, |m| m.max_range_m)
        });
        let origins = Some(self.placed.origins.as_slice()).filter(|o| !o.is_empty());
        let up = (scan.pose.rotation * glam::DVec3::Z).as_vec3();
        self.surfels.update(&self.placed.points, origins, up, &self.config);
        let voxels_per_m = (1.0 / map.config().voxel_size_m) as f32;
        let (fused_returns, skipped) = self.make_discs(max_range_m, voxels_per_m);
        let prepare_secs = start.elapsed().as_secs_f64();

        let truncation = map.config().truncation_vox();
        let discs = &self.discs;
        let integration = self.gather.run(
            map,
            discs.len(),
            |i, near| {
                discs[i].name_blocks(truncation, i as u32, near);
                Ok(())
            },
            |_| false,
            |block, names, updates| {
                for &(_, i) in names {
                    discs[i as usize].update(block, truncation, updates);
                }
            },
        );
        Ok(Integration {
            fused_returns,
            skipped,
            prepare_secs,
            ..integration
        })
    }
}

/// A surfel in the grid, lengths in voxels.
#[derive(Clone, Copy, Debug)]
struct Disc {
    center: GridPoint,
    normal: Vec3,
    radius: f32,
    /// By range.
    weight: f32,
}

/// Far above the rounding errors of f32 within a disc, voxels.
const SLACK: f32 = 0.01;

/// Half the diagonal between the centres of a block's outermost voxels.
const BLOCK_RADIUS: f32 = 3.5 * 1.732_050_8;

impl Disc {
    /// The centre of a voxel relative to the disc's.
    #[inline]
    fn offset(&self, voxel: glam::IVec3) -> Vec3 {
        (voxel - self.center.voxel).as_vec3() + 0.5 - self.center.fraction
    }

    /// Names the blocks that the cylinder may reach into: column by column along the axis on which the normal is longest.
    fn name_blocks(&self, half_height: f32, tag: u32, near: &mut Near) {
        let a = self.normal.abs();
        if a.x >= a.y && a.x >= a.z {
            self.name_columns::<0, 1, 2>(half_height, tag, near);
        } else if a.y >= a.z {
            self.name_columns::<1, 2, 0>(half_height, tag, near);
        } else {
            self.name_columns::<2, 0, 1>(half_height, tag, near);
        }
    }

    fn name_columns<const M: usize, const U: usize, const W: usize>(
        &self,
        half_height: f32,
        tag: u32,
        near: &mut Near,
    ) {
        // All in blocks here, the centre's block being 0.
        let edge = BLOCK_EDGE as f32;
        let home = BlockIndex::of(self.center.voxel);
        let center = -self.offset(home.first_voxel() + 4) + 0.5; // of the disc, from the middle of its block, voxels
        let normal = self.normal;
        let half_box = self.half_box(half_height) + (3.5 + SLACK);
        let (low, high) = ((center - half_box) / edge, (center + half_box) / edge);
        // A block's middle is at most this far from the plane, and from the line.
        let thick = half_height + 3.5 * (normal.abs().element_sum()) + SLACK;
        let wide = self.radius + BLOCK_RADIUS + SLACK;
        let half_m = thick / normal[M].abs();
        for w in round(low[W] + 0.5)..=round(high[W] - 0.5) {
            for u in round(low[U] + 0.5)..=round(high[U] - 0.5) {
                let (du, dw) = (edge * u as f32 - center[U], edge * w as f32 - center[W]);
                let plane_m = center[M] - (du * normal[U] + dw * normal[W]) / normal[M];
                let first = low[M].max((plane_m - half_m) / edge);
                let last = high[M].min((plane_m + half_m) / edge);
                for m in round(first + 0.5)..=round(last - 0.5) {
                    let dm = edge * m as f32 - center[M];
                    let along = dm * normal[M] + du * normal[U] + dw * normal[W];
                    if dm * dm + du * du + dw * dw - along * along <= wide * wide {
                        let mut block = home.0;
                        (block[M], block[U], block[W]) = (home.0[M] + m, home.0[U] + u, home.0[W] + w);
                        near.block(BlockIndex(block), tag);
                    }
                }
            }
        }
    }

    /// Updates the voxels of one block that lie in the cylinder: row by row along x, of which those that it may reach into are
    /// tested voxel by voxel.
    fn update(&self, block: BlockIndex, half_height: f32, updates: &mut Updates) {
        let first = self.offset(block.first_voxel());
        let n = self.normal;
        let inverse = 1.0 / half_height;
        let radius2 = self.radius * self.radius;
        // A row's middle is at most this far from the plane.
        let thick = half_height + 3.5 * n.x.abs() + SLACK;
        // A line along x, off by (y, z), comes as near to the axis as √(y² + z² − (y·n_y + z·n_z)²/(1 − n_x²)).
        let radius2_slack = (self.radius + SLACK) * (self.radius + SLACK);
        let share = 1.0 / (1.0 - n.x * n.x).max(SLACK * SLACK);
        let reach = self.half_box(half_height) + SLACK;
        let rows = |first: f32, reach: f32| {
            let (low, high) = (round(-reach - first + 0.5), round(reach - first - 0.5));
            low.max(0)..(high + 1).min(BLOCK_EDGE)
        };
        for k in rows(first.z, reach.z) {
            for j in rows(first.y, reach.y) {
                let (y, z) = (first.y + j as f32, first.z + k as f32);
                let across = y * n.y + z * n.z;
                let base2 = y * y + z * z;
                if ((first.x + 3.5) * n.x + across).abs() > thick || base2 - across * across * share > radius2_slack {
                    continue;
                }
                updates.add_row((j + BLOCK_EDGE * k) as usize, |x| {
                    let dx = first.x + x;
                    let along = dx * n.x + across;
                    let distance2 = dx * dx + base2;
                    let inside = (distance2 - along * along <= radius2) & (along.abs() <= half_height); // (5.21)(5.22)
                    let weight = self.weight / (1.0 + distance2.sqrt() * inverse); // (5.25)(5.27)
                    (along * inverse, if inside { weight } else { 0.0 }) // (5.24)
                });
            }
        }
    }

    /// Half the edges of the cylinder's bounding box.
    fn half_box(&self, half_height: f32) -> Vec3 {
        let across = (Vec3::ONE - self.normal * self.normal).max(Vec3::ZERO);
        let across = Vec3::new(across.x.sqrt(), across.y.sqrt(), across.z.sqrt());
        self.normal.abs() * half_height + across * self.radius
    }
}
