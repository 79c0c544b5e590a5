//! Which part of a map a scan can touch: known before it is fused, so that of a map larger than memory it can be there.

use glam::{DVec3, IVec3};

use crate::{
    fuse::{FuseConfig, Method},
    index::{Grid, RegionIndex},
    map::{MapConfig, REGION_SHIFT},
    scan::Scan,
};

/// A ball in the world that holds every voxel whose bits can change, or matter, when a scan is fused.
///
/// It is the farthest return that decides: rays erase, and see that there is nothing, all along. In a street most of the ball
/// is seen anyway.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// The sensor's position, metres.
    pub center: DVec3,
    /// From there, metres.
    pub radius_m: f64,
}

/// Beyond the farthest return: depths that are made up in holes of an image may be by this factor farther than those about them,
const FACTOR: f64 = 1.1;
/// and windows and gaps of `patch`, centres of projection and neighbourhoods reach so many metres,
const MARGIN_M: f64 = 5.0;
/// and bands about a surface this many truncations (along the optical axis of a camera, which sees its corners from afar).
const TRUNCATIONS: f64 = 4.0;

impl Method {
    /// What fusing a scan into a map can touch. Returns that are farther away than the scan's range limits must have been dropped.
    pub fn reach(self, config: &FuseConfig, map: &MapConfig, scan: &Scan) -> Reach {
        let farthest = scan.points.iter().map(|p| p.length()).filter(|m| m.is_finite());
        let farthest = f64::from(farthest.fold(0.0, f32::max));
        // The sensor moves on a straight line, so its way is longest at the first or the last return.
        let times = scan.times.iter().flatten().copied().filter(|t| t.is_finite());
        let times = times.fold(None, |range: Option<(f32, f32)>, t| {
            let (low, high) = range.unwrap_or((t, t));
            Some((low.min(t), high.max(t)))
        });
        let way = scan.trajectory().zip(times).map_or(0.0, |(trajectory, (low, high))| {
            let shift = |t: f32| trajectory.relative_at(f64::from(t)).1.length();
            shift(low).max(shift(high))
        });
        let disc_m = match self {
            // Half the diagonal of the coarsest cell is the most that a standard deviation can be.
            Self::Surfel => {
                let surfel = &config.surfel;
                let coarsest_m = f64::from(surfel.finest_cell_m) * f64::from(surfel.levels).exp2();
                f64::from(surfel.radius_sigmas) * coarsest_m
            }
            _ => 0.0,
        };
        Reach {
            center: scan.pose.translation,
            radius_m: FACTOR * (farthest + way) + MARGIN_M + TRUNCATIONS * map.truncation_m + disc_m,
        }
    }
}

impl Reach {
    /// Whether any of a region lies within it.
    pub fn touches(&self, RegionIndex(region): RegionIndex, grid: Grid) -> bool {
        let edge_m = f64::from(1 << REGION_SHIFT) * grid.voxel_size_m();
        let corner = |region: IVec3| region.as_dvec3() * edge_m;
        let nearest = self.center.clamp(corner(region), corner(region + 1));
        nearest.distance_squared(self.center) <= self.radius_m * self.radius_m
    }
}
