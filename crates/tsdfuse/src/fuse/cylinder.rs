//! The voxels about a line: what raycasting (5.5)(5.6), local normals (5.14)(5.15) and surfels (5.21)(5.22) all visit.
//!
//! A literal implementation tests every voxel of a cube. This one walks the layers of the dominant axis; in a layer the
//! cylinder is an ellipse, of which each row is an interval found from a quadratic. The interval only proposes: it is widened
//! by [`SLACK`], and the exact predicate decides, so that rounding cannot make the two differ.

use glam::{IVec3, Vec3};

use crate::index::{GridPoint, round};

/// √3/2: the largest distance of a point in a voxel to its centre, in voxels (5.6).
pub(crate) const VOXEL_RADIUS: f32 = 0.866_025_4;

/// Widening of proposed intervals, in voxels: far above the rounding errors of f32 in such a small neighbourhood.
const SLACK: f32 = 1e-3;

/// All voxels whose centre is at most `radius` from the line through `center` along `axis`, and at most `half_length` from
/// the plane through `center` across it. Lengths in voxels, `axis` of unit length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cylinder {
    pub(crate) center: GridPoint,
    pub(crate) axis: Vec3,
    pub(crate) radius: f32,
    pub(crate) half_length: f32,
}

/// A voxel of a cylinder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Member {
    pub(crate) voxel: IVec3,
    /// ‖v − c‖², voxels².
    pub(crate) distance2: f32,
    /// (v − c)·axis, voxels.
    pub(crate) along: f32,
}

impl Cylinder {
    /// The exact predicate: is the voxel with this centre, given relative to the cylinder's own, inside?
    #[inline]
    fn member(&self, voxel: IVec3, offset: Vec3) -> Option<Member> {
        let distance2 = offset.length_squared();
        let along = offset.dot(self.axis);
        let inside = distance2 - along * along <= self.radius * self.radius && along.abs() <= self.half_length;
        inside.then_some(Member {
            voxel,
            distance2,
            along,
        })
    }

    /// Lowest and highest voxel of the cylinder's bounding box, relative to the centre's voxel.
    fn bounds(&self) -> (IVec3, IVec3) {
        let across = (Vec3::ONE - self.axis * self.axis).max(Vec3::ZERO);
        let sqrt = Vec3::new(across.x.sqrt(), across.y.sqrt(), across.z.sqrt());
        let half = self.axis.abs() * self.half_length + sqrt * self.radius + SLACK;
        // The centre of voxel i lies at i + ½ − fraction.
        let lowest = self.center.fraction - 0.5 - half;
        let highest = self.center.fraction - 0.5 + half;
        (
            IVec3::new(ceil(lowest.x), ceil(lowest.y), ceil(lowest.z)),
            IVec3::new(floor(highest.x), floor(highest.y), floor(highest.z)),
        )
    }

    /// The voxel with the lowest coordinates that the cylinder may hold.
    pub(crate) fn lowest_voxel(&self) -> IVec3 {
        self.center.voxel + self.bounds().0
    }

    /// Visits every voxel of the cylinder once.
    #[inline]
    pub(crate) fn for_each(&self, mut visit: impl FnMut(Member)) {
        let a = self.axis.abs();
        // Permute axes so that the line runs mostly along the first: (m, u, w).
        if a.x >= a.y && a.x >= a.z {
            self.walk::<0, 1, 2>(&mut visit);
        } else if a.y >= a.z {
            self.walk::<1, 2, 0>(&mut visit);
        } else {
            self.walk::<2, 0, 1>(&mut visit);
        }
    }

    #[inline]
    fn walk<const M: usize, const U: usize, const W: usize>(&self, visit: &mut impl FnMut(Member)) {
        let center = self.center.fraction.to_array();
        let axis = self.axis.to_array();
        let (am, au, aw) = (axis[M], axis[U], axis[W]);
        let (lowest, highest) = self.bounds();
        let (lowest, highest) = (lowest.to_array(), highest.to_array());
        let inv_m = 1.0 / am;
        // Half extent along u of the ellipse that a layer cuts out, and the quadratic's constants in a row.
        let half_u = self.radius * (1.0 - aw * aw).max(0.0).sqrt() * inv_m.abs() + SLACK;
        let quad = 1.0 - aw * aw; // ≥ 2/3 − ε: w is not the dominant axis, so the row's quadratic is well conditioned
        let inv_quad = 1.0 / quad;
        let radius2 = self.radius * self.radius;
        for m in lowest[M]..=highest[M] {
            let dm = m as f32 + 0.5 - center[M];
            let line_u = dm * inv_m * au + center[U] - 0.5;
            for u in ceil(line_u - half_u)..=floor(line_u + half_u) {
                let du = u as f32 + 0.5 - center[U];
                // ‖d‖² − (d·a)² ≤ r² for d = (dm, du, dw):  quad·dw² − 2·aw·s·dw + (dm² + du² − s²) ≤ r²
                let s = dm * am + du * au;
                let mid = aw * s * inv_quad;
                let disc = mid * mid - (dm * dm + du * du - s * s - radius2) * inv_quad;
                if disc < -SLACK {
                    continue;
                }
                let half = disc.max(0.0).sqrt() + SLACK;
                let line_w = mid + center[W] - 0.5;
                for w in ceil(line_w - half)..=floor(line_w + half) {
                    let dw = w as f32 + 0.5 - center[W];
                    let mut offset = [0.0; 3];
                    let mut voxel = [0; 3];
                    (offset[M], offset[U], offset[W]) = (dm, du, dw);
                    (voxel[M], voxel[U], voxel[W]) = (m, u, w);
                    if let Some(member) = self.member(self.center.voxel + IVec3::from(voxel), offset.into()) {
                        visit(member);
                    }
                }
            }
        }
    }
}

/// The least integer that is not more than half a slack below x.
#[inline]
fn ceil(x: f32) -> i32 {
    round(x + (0.5 - 0.5 * SLACK))
}

/// The greatest integer that is not more than half a slack above x.
#[inline]
fn floor(x: f32) -> i32 {
    round(x - (0.5 - 0.5 * SLACK))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every voxel of a cube, tested one by one.
    fn literal(c: &Cylinder) -> Vec<Member> {
        let reach = (c.half_length + c.radius).ceil() as i32 + 2;
        let mut all = Vec::new();
        for z in -reach..=reach {
            for y in -reach..=reach {
                for x in -reach..=reach {
                    let i = IVec3::new(x, y, z);
                    all.extend(c.member(c.center.voxel + i, i.as_vec3() + 0.5 - c.center.fraction));
                }
            }
        }
        all
    }

    fn fast(c: &Cylinder) -> Vec<Member> {
        let mut all = Vec::new();
        c.for_each(|m| all.push(m));
        all
    }

    fn sorted(mut all: Vec<Member>) -> Vec<Member> {
        all.sort_by_key(|m| m.voxel.to_array());
        all
    }

    fn any_cylinder() -> impl Strategy<Value = Cylinder> {
        let axis = prop_oneof![
            prop::array::uniform3(-1.0..1.0f32),
            prop::array::uniform3(-1..=1i32).prop_map(|v| IVec3::from(v).as_vec3().to_array()),
        ];
        let fraction = prop::array::uniform3(prop_oneof![0.0..1.0f32, Just(0.5), Just(0.0), Just(1.0)]);
        (axis, fraction, 0.3..5.0f32, 0.5..9.0f32).prop_filter_map("no axis", |(a, f, radius, half_length)| {
            let axis = Vec3::from(a).try_normalize()?;
            let center = GridPoint {
                voxel: IVec3::new(-3, 1000, -70_000),
                fraction: f.into(),
            };
            Some(Cylinder {
                center,
                axis,
                radius,
                half_length,
            })
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn the_walk_visits_what_the_literal_test_finds(c in any_cylinder()) {
            prop_assert_eq!(sorted(fast(&c)), sorted(literal(&c)));
        }

        #[test]
        fn the_bounds_hold_every_member(c in any_cylinder()) {
            let (low, high) = c.bounds();
            for m in literal(&c) {
                let i = m.voxel - c.center.voxel;
                prop_assert!(i.cmpge(low).all() && i.cmple(high).all());
            }
        }
    }

    #[test]
    fn the_comparison_would_see_a_missing_voxel() {
        let c = Cylinder {
            center: GridPoint {
                voxel: IVec3::ZERO,
                fraction: Vec3::splat(0.3),
            },
            axis: Vec3::new(0.6, 0.0, 0.8),
            radius: VOXEL_RADIUS,
            half_length: 4.0,
        };
        let mut missing = fast(&c);
        missing.pop();
        assert_ne!(sorted(missing), sorted(literal(&c)));
    }
}
