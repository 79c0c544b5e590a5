//! Densely observed places.

use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};
use tsdfuse::glam::{DVec3, IVec3};

use crate::error::{EvalError, Result};

/// The rule by which a place counts as densely observed: space is divided into cubes, and the place's cube and its 26 neighbours
/// together contain this many reference points.
///
/// So a sample may count although it is farther than a cube's edge from every reference point: large errors beside
/// well-observed surfaces stay in the figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DenseRule {
    /// The edge of a cube, metres.
    pub cube_m: f64,
    /// The least number of reference points in 3 × 3 × 3 cubes.
    pub points: u64,
}

impl Default for DenseRule {
    /// Four points per 5 cm × 5 cm of a plane through 3 × 3 cubes of 25 cm: 4 · (0.75 / 0.05)².
    fn default() -> Self {
        Self {
            cube_m: 0.25,
            points: 900,
        }
    }
}

impl DenseRule {
    pub(crate) fn check(&self) -> Result<()> {
        if self.cube_m >= 1e-3 && self.cube_m.is_finite() {
            Ok(())
        } else {
            Err(EvalError::Protocol {
                field: "dense.cube_m",
                wrong: format!("must be 0.001 or more, not {}", self.cube_m),
            })
        }
    }
}

/// The number of reference points in each cube.
pub struct Density {
    rule: DenseRule,
    cubes: FxHashMap<IVec3, u64>,
}

impl Density {
    /// Counts the points of each cube.
    pub fn of(points: &[DVec3], rule: DenseRule) -> Self {
        let mut cubes = FxHashMap::default();
        for &point in points {
            *cubes.entry(cube(point, rule.cube_m)).or_insert(0) += 1;
        }
        Self { rule, cubes }
    }

    /// Whether each of `places` is densely observed.
    pub fn dense(&self, places: &[DVec3]) -> Vec<bool> {
        use rayon::prelude::*;
        let part = |places: &[DVec3]| {
            // Places have the order of triangles or rays, so a place is often in the same cube as the one before.
            let mut last = None;
            let dense = places.iter().map(|&place| {
                let cube = cube(place, self.rule.cube_m);
                match last {
                    Some((same, dense)) if same == cube => dense,
                    _ => last.insert((cube, self.is_dense(cube))).1,
                }
            });
            dense.collect::<Vec<bool>>()
        };
        places.par_chunks(1 << 14).flat_map_iter(part).collect()
    }

    fn is_dense(&self, cube: IVec3) -> bool {
        let steps = || [0, -1, 1].into_iter();
        let around = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| IVec3::new(x, y, z))));
        let mut held = 0;
        around
            .map(|step| self.cubes.get(&cube.saturating_add(step)).copied().unwrap_or(0))
            .any(|count| {
                held += count;
                held >= self.rule.points
            })
    }
}

fn cube(point: DVec3, cube_m: f64) -> IVec3 {
    (point / cube_m).floor().as_ivec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_27_cubes_are_counted(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0), 0..60),
            places in prop::collection::vec(prop::array::uniform3(-1.5..1.5), 1..20),
            needed in 0..12_u64,
        ) {
            let rule = DenseRule { cube_m: 0.25, points: needed };
            let [points, places] = [points, places].map(|p: Vec<[f64; 3]>| p.into_iter().map(DVec3::from).collect::<Vec<_>>());
            let literal: Vec<bool> = places.iter().map(|place| {
                let near = |p: &&DVec3| ((**p * 4.0).floor() - (*place * 4.0).floor()).abs().max_element() <= 1.0;
                points.iter().filter(near).count() as u64 >= needed
            }).collect();
            prop_assert_eq!(Density::of(&points, rule).dense(&places), literal);
        }
    }

    #[test]
    fn one_point_more_or_less_decides() {
        let points = vec![DVec3::splat(0.1); 10];
        let dense = |points: &[DVec3]| {
            let rule = DenseRule {
                cube_m: 0.25,
                points: 10,
            };
            Density::of(points, rule).dense(&[DVec3::splat(0.3), DVec3::splat(0.6)])
        };
        assert_eq!(dense(&points), [true, false]);
        assert_eq!(dense(&points[1..]), [false, false]);
    }
}
