//! The rays of a scan, in voxels.

use rayon::prelude::*;
use tsdfuse::Scan;
use tsdfuse::glam::{DVec3, IVec3, Vec2, Vec2Swizzles, Vec3};
use tsdfuse::scan::ScanError;

use crate::marks::Marks;

/// Farther from the origin, in voxels, voxels have no number.
const FAR: f64 = 1e9;
/// Ends of the ranges, in voxels, in which rays of nearly the same direction count as one.
const SHELLS: [usize; 4] = [20, 40, 80, 160];

/// The rays of a scan, each from where the sensor was at its time.
pub(crate) struct Rays {
    /// Both ends, in voxels; `None` for those that leave the grid.
    ends: Vec<Option<[DVec3; 2]>>,
    /// The voxel of each return within range.
    pub(crate) hits: Vec<Option<IVec3>>,
}

impl Rays {
    /// The rays, followed up to a range in metres.
    pub(crate) fn of(scan: &Scan, voxel_size_m: f64, max_range_m: f64) -> Result<Self, ScanError> {
        let ray = |(pose, point): (tsdfuse::Pose, &Vec3)| {
            let (from, way) = (pose.translation, pose.rotation * point.as_dvec3());
            let share = (max_range_m / way.length()).min(1.0);
            let ends = [from, from + way * share].map(|end| end / voxel_size_m);
            // Also false for NaN.
            let is_inside = ends.iter().all(|end| end.abs().max_element() < FAR);
            let hit = (is_inside && share == 1.0).then(|| ends[1].floor().as_ivec3());
            (is_inside.then_some(ends), hit)
        };
        // Poses one after the other, since many returns in a row have the same.
        let poses: Vec<tsdfuse::Pose> = scan.poses()?.collect();
        let (ends, hits) = poses.into_par_iter().zip(&scan.points).map(ray).unzip();
        Ok(Self { ends, hits })
    }

    /// Follows only one of rays that run side by side, less than a voxel apart: near the sensor, voxels are passed many times. Where rays
    /// end stays, and nothing is passed that was not.
    pub(crate) fn thin(&mut self) {
        // How far rays have been followed in each range, by their direction.
        let mut followed = SHELLS.map(|end| vec![0_f32; cells(end) * cells(end)]);
        for [from, to] in self.ends.iter_mut().flatten() {
            let way = *to - *from;
            let (range, direction) = (way.length() as f32, octahedral(way.as_vec3()));
            let (mut start, mut is_followed) = (0.0, false);
            for (end, followed) in SHELLS.into_iter().zip(&mut followed) {
                let at = (direction * cells(end) as f32).as_usizevec2();
                let (until, followed) = (range.min(end as f32), &mut followed[at.x * cells(end) + at.y]);
                is_followed |= *followed < until;
                if is_followed {
                    *followed = followed.max(until);
                } else {
                    start = until;
                }
                if until == range {
                    break;
                }
            }
            if start > 0.0 {
                *from += way * f64::from(start / range);
            }
        }
    }

    /// What they pass through and where they end. The union does not depend on how rays are divided among threads.
    pub(crate) fn marks(&self) -> Marks {
        let each = self.ends.len().div_ceil(rayon::current_num_threads()).max(1);
        let parts = self.ends.par_chunks(each).zip(self.hits.par_chunks(each));
        let marks = parts.map(|(ends, hits)| {
            let mut marks = Marks::default();
            for (ends, hit) in ends.iter().zip(hits) {
                if let Some([from, to]) = ends {
                    marks.ray(*from, *to, hit.is_some());
                }
            }
            marks
        });
        marks.reduce(Marks::default, Marks::merged)
    }
}

/// Along an edge of the square of all directions: cells at most a voxel wide at a range in voxels.
fn cells(range: usize) -> usize {
    4 * range
}

/// The place of a direction in the square from 0 to 1 (octahedral projection: Cigolle et al., "A Survey of Efficient Representations for
/// Independent Unit Vectors", JCGT 2014). 0 and what is not a direction is at 0.
fn octahedral(way: Vec3) -> Vec2 {
    let way = way / way.abs().element_sum();
    let at = way.truncate();
    let at = if way.z < 0.0 {
        (1.0 - at.yx().abs()) * Vec2::ONE.copysign(at)
    } else {
        at
    };
    (0.5 + 0.5 * at).clamp(Vec2::ZERO, Vec2::splat(1.0 - f32::EPSILON))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;
    use tsdfuse::Pose;
    use tsdfuse::glam::{DQuat, EulerRot};

    use super::*;
    use crate::marks::{bits, voxel_of};

    /// The voxels that are passed, and those in which rays end.
    fn touched(rays: &Rays) -> [BTreeSet<[i32; 3]>; 2] {
        let mut touched = [BTreeSet::new(), BTreeSet::new()];
        for (index, marks) in rays.marks().into_chunks() {
            for (word, (passed, hit)) in marks.words().enumerate() {
                let at = |bit| voxel_of(index, 64 * word + bit).to_array();
                bits(passed, |bit| touched[0].extend([at(bit)]));
                bits(hit, |bit| touched[1].extend([at(bit)]));
            }
        }
        touched
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn thinned_rays_leave_no_gap(
            far_m in 3.0..60.0_f32,
            tilt in -1.0..1.0_f32,
            near in prop::collection::vec((0..60_usize, 0.1..1.0_f32), 0..20),
        ) {
            // A wall as many beams see it, and things before it.
            let mut points: Vec<Vec3> = (0..3600)
                .map(|i| far_m * Vec3::new(1.0, 0.01 * (i % 60 - 30) as f32, 0.01 * (i / 60 - 30) as f32 + 0.3 * tilt))
                .collect();
            for (at, share) in near {
                points[60 * at..60 * at + 20].iter_mut().for_each(|point| *point *= share);
            }
            // No ray runs along the edge of a voxel.
            let pose = Pose {
                rotation: DQuat::from_euler(EulerRot::ZYX, 0.3, 0.2, 0.1),
                translation: DVec3::new(0.123, 0.456, 0.789),
            };
            let scan = Scan { points, pose: Some(pose), ..Default::default() };
            let all = Rays::of(&scan, 0.25, 40.0).unwrap();
            let mut thinned = Rays::of(&scan, 0.25, 40.0).unwrap();
            thinned.thin();
            let ([passed, hit], [thinned_passed, thinned_hit]) = (touched(&all), touched(&thinned));
            prop_assert_eq!(hit, thinned_hit);
            prop_assert!(thinned_passed.is_subset(&passed));
            for voxel in passed {
                let near = (0..27).map(|i| [voxel[0] + i % 3 - 1, voxel[1] + i / 3 % 3 - 1, voxel[2] + i / 9 - 1]);
                let is_near = near.into_iter().any(|voxel| thinned_passed.contains(&voxel));
                prop_assert!(is_near, "{:?}", voxel);
            }
            let steps = |rays: &Rays| rays.ends.iter().flatten().map(|[from, to]| (*to - *from).length()).sum::<f64>();
            prop_assert!(steps(&thinned) < 0.8 * steps(&all), "{} of {}", steps(&thinned), steps(&all));
        }
    }
}
