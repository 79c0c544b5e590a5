//! Which part of a map a scan can touch: known before it is fused, so that of a map larger than memory it can be there.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec2, DVec3, IVec3, Vec3};
use rayon::prelude::*;

use crate::{
    fuse::{FuseConfig, FuseError, Method},
    index::{Grid, RegionIndex},
    map::{MapConfig, REGION_SHIFT},
    patch::widest_gap_m,
    pose::Pose,
    scan::Scan,
    sensor::approx::atan2_f32,
    surfel::SurfelConfig,
};

/// Sectors about the sensor, seen from above.
const SECTORS: usize = 128;
const SECTOR_RAD: f64 = TAU / SECTORS as f64;

/// A part of the world that holds every voxel whose bits can change, or matter, when a scan is fused: around the sensor's position, in each sector
/// of azimuth, as far as the farthest return in it.
///
/// It is the whole way to the returns: rays erase, and see that there is nothing, all along.
#[derive(Clone, Debug, PartialEq)]
pub struct Reach {
    /// The sensor's position, metres.
    pub center: DVec3,
    /// How far away the farthest return is, metres.
    radius_m: f64,
    /// And that of each sector, from above; the first one begins at −x.
    sectors_m: [f32; SECTORS],
    /// How much farther voxels may lie, in any direction.
    margin_m: f64,
}

/// Depths that are made up in holes of an image may be by this factor farther than those about them,
const FACTOR: f64 = 1.1;
/// in columns this far away.
const HOLES_RAD: f64 = 0.05;
/// Windows of `patch` and centres of projection are not farther than this from returns,
const MARGIN_M: f64 = 2.0;
/// neighbourhoods so many voxels,
const NEIGHBOURHOOD_VOX: f64 = 16.0;
/// bands about a surface this many truncations (along the optical axis of a camera, which sees its corners from afar).
const TRUNCATIONS: f64 = 4.0;

impl Method {
    /// What fusing a scan into a map can touch. Returns beyond the scan's range limits must have been dropped.
    ///
    /// # Errors
    /// [`FuseError::Scan`] for a scan without a pose.
    pub fn reach(self, config: &FuseConfig, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        let pose = scan.world_from_sensor()?;
        let (way_m, turn_rad) = motion(scan, &pose);
        let (farthest_m, sectors_m) = farthest(scan, &pose);
        let beside_m = match self {
            Self::Surfel => disc_m(&config.surfel, f64::from(farthest_m)),
            Self::Patch => f64::from(widest_gap_m(config.patch.max_gap_m, farthest_m)),
            _ => 0.0,
        };
        let wider = ((turn_rad + HOLES_RAD) / SECTOR_RAD).ceil() as usize + 1;
        Ok(Reach {
            center: pose.translation,
            radius_m: FACTOR * f64::from(farthest_m),
            sectors_m: std::array::from_fn(|sector| {
                let beside = (0..=2 * wider.min(SECTORS / 2)).map(|k| (sector + SECTORS + k - wider) % SECTORS);
                FACTOR as f32 * beside.map(|sector| sectors_m[sector]).fold(0.0, f32::max)
            }),
            margin_m: MARGIN_M
                + NEIGHBOURHOOD_VOX * map.voxel_size_m
                + TRUNCATIONS * map.truncation_m
                + beside_m
                + FACTOR * way_m,
        })
    }
}

/// The largest radius that a surfel can have, at this range or nearer.
fn disc_m(config: &SurfelConfig, range_m: f64) -> f64 {
    let coarsest = f64::from(config.levels.saturating_sub(1)).exp2();
    let reached = (2.0 * range_m / f64::from(config.finest_range_m)).max(1.0);
    let cell_m = f64::from(config.finest_cell_m) * coarsest.min(reached);
    // No standard deviation exceeds half the diagonal of a cell.
    f64::from(config.radius_sigmas) * 0.5 * 3f64.sqrt() * cell_m
}

/// How far the sensor was from its pose while it measured, and how much it was turned.
fn motion(scan: &Scan, pose: &Pose) -> (f64, f64) {
    let times = scan.times.iter().flatten().copied().filter(|t| t.is_finite());
    let range = times.fold(None, |range: Option<(f32, f32)>, t| {
        let (low, high) = range.unwrap_or((t, t));
        Some((low.min(t), high.max(t)))
    });
    let Some((sweep, (low, high))) = scan.sweep().zip(range) else {
        return (0.0, 0.0);
    };
    // At constant velocity it is farthest at the first or the last return, or where the velocity changes.
    let (low, high) = (f64::from(low), f64::from(high));
    let between = sweep.knots().filter(|t| (low..high).contains(t));
    [low, high]
        .into_iter()
        .chain(between)
        .fold((0.0, 0.0), |(way_m, turn_rad): (f64, f64), secs| {
            let (rotation, shift) = sweep.relative_at(secs);
            (
                way_m.max(shift.length()),
                turn_rad.max(rotation.angle_between(pose.rotation)),
            )
        })
}

/// The range of the farthest return, and from above in each sector.
fn farthest(scan: &Scan, pose: &Pose) -> (f32, [f32; SECTORS]) {
    let rotation = DMat3::from_quat(pose.rotation).as_mat3();
    let of = |points: &[Vec3]| {
        let (mut farthest, mut sectors) = (0.0f32, [0.0f32; SECTORS]);
        for point in points.iter().map(|p| rotation * p) {
            let range = point.length();
            if range.is_finite() {
                farthest = farthest.max(range);
                let sector = &mut sectors[sector_of(atan2_f32(point.y, point.x))];
                *sector = sector.max(point.truncate().length());
            }
        }
        (farthest, sectors)
    };
    let all = scan.points.par_chunks(1 << 13).map(of);
    all.reduce(
        || (0.0, [0.0; SECTORS]),
        |(a, mut sectors), (b, other)| {
            sectors.iter_mut().zip(other).for_each(|(m, other)| *m = m.max(other));
            (a.max(b), sectors)
        },
    )
}

/// The sector of an azimuth.
fn sector_of(azimuth_rad: f32) -> usize {
    (f64::from(azimuth_rad + PI as f32) / SECTOR_RAD) as usize % SECTORS
}

impl Reach {
    /// The same from another place.
    pub fn at(&self, center: DVec3) -> Self {
        Self { center, ..self.clone() }
    }

    /// Whether any of a region lies within it.
    pub fn touches(&self, RegionIndex(region): RegionIndex, grid: Grid) -> bool {
        let edge_m = f64::from(1 << REGION_SHIFT) * grid.voxel_size_m();
        let corner = |region: IVec3| region.as_dvec3() * edge_m - self.center;
        let (low, high) = (corner(region), corner(region + 1));
        let farthest_m = self.radius_m + self.margin_m;
        if DVec3::ZERO.clamp(low, high).length_squared() > farthest_m * farthest_m {
            return false;
        }
        // From above: a circle about it, and the sectors that the circle is seen in.
        let middle: DVec2 = (0.5 * (low + high)).truncate();
        let circle_m = 0.5 * edge_m * 2f64.sqrt() + self.margin_m;
        let distance_m = middle.length();
        if distance_m <= circle_m {
            return true;
        }
        let half_rad = (circle_m / distance_m).asin();
        let azimuth_rad = middle.y.atan2(middle.x) + PI;
        let first = ((azimuth_rad - half_rad) / SECTOR_RAD).floor() as i64;
        let last = ((azimuth_rad + half_rad) / SECTOR_RAD).floor() as i64;
        let reaches = |sector: i64| {
            let sector = sector.rem_euclid(SECTORS as i64) as usize;
            f64::from(self.sectors_m[sector]) >= distance_m - circle_m
        };
        (first..=last).any(reaches)
    }
}
