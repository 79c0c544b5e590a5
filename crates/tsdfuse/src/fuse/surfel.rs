//! Surfels (S), thesis 5.5: the returns of a scan are summarized by planar discs, and each disc updates the voxels around it.
//!
//! Which voxels: within the radius of the disc from the line through c along n (5.21), within μ of its plane (5.22). Thesis 6.3
//! visits a cube of edge 2λ₁ only, which cuts off this cylinder; we visit all of it. What distance: (v − c)·n/μ (5.24), to the
//! plane. What weight: (1 − ‖o − c‖/χ) · 1/(1 + ‖v − c‖/μ) (5.25)–(5.27), by range and by distance from the centre of the disc.
//! The discs come from [`SurfelMap`].
//!
//! The thesis takes the size of the longest vector as the radius, which is `radius_sigmas = 1`. The default of 1.5 covers more, at
//! the price of a larger error.
//!
//! Strong on large flat surfaces seen head-on: the noise of many returns is averaged, and gaps between the scan lines are covered.
//! Weak everywhere else (thesis 7.5): detail smaller than a cell is lost, discs extend beyond edges, cells with few returns leave
//! holes, and a cell crossed by a single scan line has a wrong normal. Ground seen at grazing incidence is torn, because noise
//! decides which way the normals of its cells point. `ground_flip` repairs that, and spoils walls below the sensor.

use std::time::Instant;

use fearless_simd::{Simd, dispatch, f32x8, mask32x8, prelude::*};

use super::{
    FuseError, Integration, Integrator, Skipped,
    cylinder::{Cylinder, EightVoxels},
    gather::Gather,
    placed::Placed,
};
use crate::{
    map::{MapConfig, VoxelMap},
    reach::Reach,
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
    gather: Gather<Disc>,
}

impl Surfels {
    /// With the given options. Only the maximum range of the sensor is used. Without a model, the first scan decides which sensor it
    /// is; if no beams can be found in it, the default of [`RangeLimits`] applies.
    pub fn new(config: SurfelConfig, sensor: Option<&SensorModel>) -> Self {
        Self {
            config,
            max_range_m: sensor.map(|s| s.max_range_m),
            ..Self::default()
        }
    }

    /// Makes the discs of the surfels. Returns the number of fused returns, and of skipped ones by reason.
    fn make_discs(&mut self, max_range_m: f32, config: &MapConfig) -> (u64, Skipped) {
        let voxels_per_m = (1.0 / config.voxel_size_m) as f32;
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
                    let radius = surfel.radius_m * voxels_per_m;
                    let about = Cylinder::new(center, surfel.normal, radius, config.truncation_vox());
                    self.discs.push(Disc { about, weight });
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
        let up = (scan.world_from_sensor()?.rotation * glam::DVec3::Z).as_vec3();
        self.surfels.update(&self.placed.points, origins, up, &self.config);
        let (fused_returns, skipped) = self.make_discs(max_range_m, map.config());
        let prepare_secs = start.elapsed().as_secs_f64();

        let integration = update(map, &mut self.gather, &self.discs);
        Ok(Integration {
            fused_returns,
            skipped,
            prepare_secs,
            ..integration
        })
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        let reach = Reach::of(map, scan)?;
        let radius_m = max_radius_m(&self.config, f64::from(reach.farthest_m()));
        Ok(reach.widened(radius_m))
    }

    fn needs_sensor(&self) -> bool {
        true
    }
}

/// The largest radius that a surfel at this range or nearer can have.
fn max_radius_m(config: &SurfelConfig, range_m: f64) -> f64 {
    let coarsest = f64::from(config.levels.saturating_sub(1)).exp2();
    let reached = (2.0 * range_m / f64::from(config.finest_range_m)).max(1.0);
    let cell_m = f64::from(config.finest_cell_m) * coarsest.min(reached);
    // No standard deviation exceeds half the diagonal of a cell.
    f64::from(config.radius_sigmas) * 0.5 * 3f64.sqrt() * cell_m
}

/// A surfel that updates voxels.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Disc {
    about: Cylinder,
    /// By range (5.26).
    weight: f32,
}

impl Disc {
    /// The rule for eight voxels: which are updated, with what distance over μ, and with what weight.
    #[inline(always)]
    fn rule<S: Simd>(&self) -> impl Fn(&EightVoxels<S>) -> (mask32x8<S>, f32x8<S>, f32x8<S>) {
        let Cylinder {
            radius, half_length, ..
        } = self.about;
        let (weight, inverse) = (self.weight, 1.0 / half_length);
        #[inline(always)]
        move |v| {
            let by_distance = weight / (v.distance2.sqrt() * inverse + 1.0); // (5.25)(5.27)
            (v.within(radius, half_length), v.along * inverse, by_distance) // (5.21)(5.22)(5.24)
        }
    }
}

/// Updates the voxels of all discs.
fn update(map: &mut VoxelMap, gather: &mut Gather<Disc>, discs: &[Disc]) -> Integration {
    let level = gather.level();
    gather.run(
        map,
        discs.len(),
        |range, near| {
            dispatch!(level, simd => for i in range {
                let disc = discs[i];
                disc.about.for_each_block(simd, #[inline(always)] |block| near.block(block, i as u32, disc));
            });
        },
        |_| false,
        |block, discs, updates| {
            dispatch!(level, simd => for disc in discs.iter() {
                let rule = disc.rule();
                disc.about.for_each_row(simd, block, #[inline(always)] |row, voxels| {
                    let (inside, distance, weight) = rule(voxels);
                    updates.add_row(row, inside, distance, weight);
                });
            });
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::cylinder::tests::any_cylinder;
    use fearless_simd::Level;
    use proptest::prelude::*;

    fn updated(level: Level, discs: &[Disc]) -> VoxelMap {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        update(&mut map, &mut Gather::with(level), discs);
        map
    }

    proptest! {
        #[test]
        fn all_instructions_give_the_same_map(
            discs in proptest::collection::vec((any_cylinder(1.0..9.0f32), 0.01..1.0f32), 1..30),
        ) {
            let discs: Vec<Disc> = discs.into_iter().map(|(about, weight)| Disc { about, weight }).collect();
            let plain = updated(Level::baseline(), &discs);
            prop_assert!(updated(Level::new(), &discs) == plain);
            prop_assert!(updated(Level::new(), &discs[1..]) != plain);
        }
    }
}
