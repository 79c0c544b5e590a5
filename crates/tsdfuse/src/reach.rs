//! Which part of a map a scan can touch. It is known before the scan is fused, so that a map larger than memory can load it.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec2, DVec3, IVec3, Vec3};
use rayon::prelude::*;

use crate::{
    index::{Grid, REGION_SHIFT, RegionIndex},
    map::MapConfig,
    pose::Pose,
    scan::{Scan, ScanError},
    sensor::approx::atan2_f32,
};

/// Sectors about the sensor, seen from above.
const SECTORS: usize = 128;
const SECTOR_RAD: f64 = TAU / SECTORS as f64;

/// A part of the world that holds every voxel that fusing a scan can read or write: around the sensor's position, in each sector of
/// azimuth as far as the farthest return in it.
///
/// The whole way to the returns belongs to it, because rays erase, and observe free space, all along.
///
/// A method returns it from [`Integrator::reach`](crate::Integrator::reach), which begins with [`Reach::of`].
#[derive(Clone, Debug, PartialEq)]
pub struct Reach {
    /// The sensor's position, metres.
    pub center: DVec3,
    /// The range of the farthest return, metres.
    farthest_m: f32,
    /// How far returns reach, made-up ones included, metres.
    radius_m: f64,
    /// The same for each sector, seen from above; the first one begins at −x.
    sectors_m: [f32; SECTORS],
    /// How much farther voxels may lie, in any direction.
    margin_m: f64,
}

/// Slack that covers what all methods do beside the returns. Those that do more say so with [`Reach::widened`] and [`Reach::turned`].
/// Depths interpolated in the holes of an image may exceed those around them by this factor,
const FACTOR: f64 = 1.1;
/// in columns at most this far away.
const HOLES_RAD: f64 = 0.05;
/// Windows for planes, and centres of projection, lie within this distance of returns,
const MARGIN_M: f64 = 2.0;
/// neighbourhoods within this many voxels,
const NEIGHBOURHOOD_VOX: f64 = 16.0;
/// bands around a surface within this many truncations (a camera measures along its optical axis, which is less at its corners).
const TRUNCATIONS: f64 = 4.0;

/// How far the sensor was from the scan's pose while it measured, and by how much it was turned.
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

/// The range of the farthest return, and the farthest horizontal distance in each sector.
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
    /// What the rays of a scan can touch, up to their ends and the band behind them, with slack for windows of 2 m and
    /// neighbourhoods of 16 voxels around the returns. Returns beyond the scan's range limits must have been dropped.
    ///
    /// # Errors
    /// [`ScanError`] if the scan contradicts itself or has no pose.
    pub fn of(map: &MapConfig, scan: &Scan) -> Result<Self, ScanError> {
        scan.check()?;
        let pose = scan.world_from_sensor()?;
        let (way_m, turn_rad) = motion(scan, &pose);
        let (farthest_m, sectors_m) = farthest(scan, &pose);
        let reach = Self {
            center: pose.translation,
            farthest_m,
            radius_m: FACTOR * f64::from(farthest_m),
            sectors_m: sectors_m.map(|range_m| FACTOR as f32 * range_m),
            margin_m: MARGIN_M + NEIGHBOURHOOD_VOX * map.voxel_size_m + TRUNCATIONS * map.truncation_m + FACTOR * way_m,
        };
        Ok(reach.turned(turn_rad + HOLES_RAD))
    }

    /// The range of the scan's farthest return, metres.
    pub fn farthest_m(&self) -> f32 {
        self.farthest_m
    }

    /// Wider by a distance in all directions: for a method that updates voxels this far from returns.
    #[must_use]
    pub fn widened(self, margin_m: f64) -> Self {
        Self {
            margin_m: self.margin_m + margin_m,
            ..self
        }
    }

    /// Wider by an angle to both sides: for a method that makes up returns this far beside measured ones.
    #[must_use]
    pub fn turned(self, angle_rad: f64) -> Self {
        let wider = (angle_rad / SECTOR_RAD).ceil() as usize + 1;
        let sectors_m = std::array::from_fn(|sector| {
            let beside =
                (0..=2 * wider.min(SECTORS / 2)).map(|k| (sector + SECTORS + k - wider.min(SECTORS / 2)) % SECTORS);
            beside.map(|sector| self.sectors_m[sector]).fold(0.0, f32::max)
        });
        Self { sectors_m, ..self }
    }

    /// The same reach from another position of the sensor.
    #[must_use]
    pub fn at(&self, center: DVec3) -> Self {
        Self { center, ..self.clone() }
    }

    /// Whether any part of a region lies within it.
    pub fn touches(&self, RegionIndex(region): RegionIndex, grid: Grid) -> bool {
        let edge_m = f64::from(1 << REGION_SHIFT) * grid.voxel_size_m();
        let corner = |region: IVec3| region.as_dvec3() * edge_m - self.center;
        let (low, high) = (corner(region), corner(region + 1));
        let farthest_m = self.radius_m + self.margin_m;
        if DVec3::ZERO.clamp(low, high).length_squared() > farthest_m * farthest_m {
            return false;
        }
        // Seen from above: a circle around the region, and the sectors that the circle covers.
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
