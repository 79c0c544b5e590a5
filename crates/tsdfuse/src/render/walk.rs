//! A ray's way through the [`Tree`].
//!
//! Down where a child is there, across where none is: empty space is left in cubes of 1 or 2 children, and the walk goes on at
//! the level at which the coordinates changed.

use glam::{DVec3, IVec3};

use super::tree::{Tree, child_number};

/// A ray through the grid of cells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// The cell that `origin` is relative to.
    pub(super) base: IVec3,
    /// Where it begins, cells.
    pub(super) origin: DVec3,
    /// Unit vector.
    pub(super) direction: DVec3,
    /// Where it begins to look for surface, cells from its origin.
    pub(super) start: f64,
    /// Where it ends.
    pub(super) length: f64,
    /// Cosine of its angle to the axis along which depths are measured; 1 if they are ranges.
    pub(super) depth_per_range: f32,
}

/// The part of a ray in a cell with surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Visit {
    pub(super) cell: IVec3,
    pub(super) block: u32,
    /// From here on the ray is in the cell, cells from its origin.
    pub(super) enter: f64,
    /// Up to here; this may lie beyond the end of the ray.
    pub(super) leave: f64,
}

/// A child and its neighbours at +x, +y and +z: eight that are aligned, counted from the lowest.
const EIGHT: u64 = 0x0033_0033;

impl Tree {
    /// Visits the cells with surface along a ray, the nearest first, until a visit gives something.
    pub(super) fn walk<T>(&self, ray: &Ray, mut visit: impl FnMut(Visit) -> Option<T>) -> Option<T> {
        let top = self.height.checked_sub(1)?;
        // Mirrored such that the ray ascends along each axis: cell c of the root becomes `mirror − c`, by flipping its bits.
        let mirror = (1 << (2 * (top + 1))) - 1;
        let down = ray.direction.cmplt(DVec3::ZERO);
        let flip = IVec3::select(down, IVec3::splat(mirror), IVec3::ZERO);
        let from_first = ray.base - self.first;
        let base = IVec3::select(down, mirror - from_first, from_first);
        let origin = DVec3::select(down, 1.0 - ray.origin, ray.origin);
        // Not quite parallel to any axis, so that all is finite.
        let direction = ray.direction.abs().max(DVec3::splat(1e-12));
        let inverse = direction.recip();

        let reaches = |corner: IVec3| ((corner - base).as_dvec3() - origin) * inverse;
        let end = reaches(IVec3::splat(mirror + 1)).min_element().min(ray.length);
        let mut t = reaches(IVec3::ZERO).max_element().max(ray.start);
        if !(t < end) {
            return None;
        }
        let half_off = origin - 0.5;
        let at = |t: f64| nearest(half_off + direction * t) + base;
        let mut cell = at(t).clamp(IVec3::ZERO, IVec3::splat(mirror));
        let mut level = top;
        // The node at each level from `level` up that holds the cell.
        let mut path = [0_u32; 16];
        loop {
            let child_at = |level: usize| child_number((cell ^ flip) >> (2 * level as i32));
            let mut node = self.nodes[path[level] as usize];
            let mut child = child_at(level);
            while level > 0 && node.children >> child & 1 == 1 {
                level -= 1;
                path[level] = node.first + (node.children & ((1 << child) - 1)).count_ones();
                node = self.nodes[path[level] as usize];
                child = child_at(level);
            }
            let eight_are_empty = node.children >> (child & 0b10_10_10) & EIGHT == 0;
            let mut next;
            if level == 0 && !eight_are_empty {
                // Cell by cell, to the end of the leaf.
                let far = (cell & -4) + 4;
                let mut sides = reaches(cell + 1);
                next = cell;
                while next.cmplt(far).all() {
                    let enter = t;
                    t = later(t, least(sides));
                    if node.children >> child_number(next ^ flip) & 1 == 1 {
                        let found = visit(Visit {
                            cell: (next ^ flip) + self.first,
                            block: node.first,
                            enter,
                            leave: t,
                        });
                        if found.is_some() {
                            return found;
                        }
                    }
                    let left = sides.cmple(DVec3::splat(t));
                    next += IVec3::select(left, IVec3::ONE, IVec3::ZERO);
                    sides += DVec3::select(left, inverse, DVec3::ZERO);
                    if t >= end {
                        return None;
                    }
                }
            } else {
                let edge = 1 << (2 * level as i32 + i32::from(eight_are_empty));
                let far = (cell & -edge) + edge;
                let sides = reaches(far);
                t = later(t, least(sides));
                if t >= end {
                    return None;
                }
                // Rounding must neither turn back nor skip a neighbour.
                next = at(t).max(cell).min(far - 1);
                next = IVec3::select(sides.cmple(DVec3::splat(t)), far, next);
            }
            if next.max_element() > mirror {
                return None;
            }
            let changed = cell ^ next;
            level = (changed.x | changed.y | changed.z).ilog2() as usize / 2;
            cell = next;
        }
    }
}

/// The smallest of three numbers that are not NaN: two instructions, where the library's are several.
#[inline]
fn least(v: DVec3) -> f64 {
    let xy = if v.x < v.y { v.x } else { v.y };
    if xy < v.z { xy } else { v.z }
}

/// The larger of two numbers that are not NaN.
#[inline]
fn later(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The nearest integers, |x| < 2³¹: a rounding addition leaves them in the low bits.
#[inline]
fn nearest(v: DVec3) -> IVec3 {
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
    let nearest = |x: f64| (x + ROUND).to_bits() as i32;
    IVec3::new(nearest(v.x), nearest(v.y), nearest(v.z))
}

#[cfg(test)]
mod tests {
    use super::super::tree::{Beam, Leaf, MAX_SPAN};
    use super::*;
    use proptest::prelude::*;

    fn leaves(cells: &[IVec3]) -> Vec<Leaf> {
        let mut leaves: std::collections::BTreeMap<[i32; 3], u64> = Default::default();
        for cell in cells {
            *leaves.entry((*cell & !3).to_array()).or_default() |= 1 << child_number(*cell);
        }
        let leaf = |(block, (cell, cells)): (usize, (&[i32; 3], &u64))| Leaf {
            cell: (*cell).into(),
            cells: *cells,
            block: block as u32,
        };
        leaves.iter().enumerate().map(leaf).collect()
    }

    /// The cells on a ray, each met by the literal test of a box, and where the ray enters and leaves.
    fn met(cells: &[IVec3], ray: &Ray) -> Vec<(IVec3, f64, f64)> {
        let mut met: Vec<_> = cells
            .iter()
            .filter_map(|&cell| {
                let a = ((cell - ray.base).as_dvec3() - ray.origin) / ray.direction;
                let b = ((cell + 1 - ray.base).as_dvec3() - ray.origin) / ray.direction;
                let enter = a.min(b).max_element().max(0.0);
                let leave = a.max(b).min_element().min(ray.length);
                (enter + 1e-6 < leave).then_some((cell, enter, leave))
            })
            .collect();
        met.sort_by(|a, b| a.1.total_cmp(&b.1));
        met
    }

    fn visited(tree: &Tree, ray: &Ray) -> Vec<(IVec3, f64, f64)> {
        let mut all = Vec::new();
        tree.walk(ray, |v| {
            if v.enter + 1e-6 < v.leave.min(ray.length) {
                all.push((v.cell, v.enter, v.leave.min(ray.length)));
            }
            None::<()>
        });
        all
    }

    fn any_ray() -> impl Strategy<Value = Ray> {
        let direction = prop::array::uniform3(prop_oneof![4 => -1.0..1.0f64, 1 => Just(0.0)]);
        let base = prop::array::uniform3(-60..60i32);
        (base, prop::array::uniform3(-0.5..0.5f64), direction, 1.0..200.0f64)
            .prop_filter("no direction", |(_, _, d, _)| DVec3::from(*d).length() > 0.1)
            .prop_map(|(base, origin, d, length)| Ray {
                start: 0.0,
                depth_per_range: 1.0,
                base: base.into(),
                origin: origin.into(),
                direction: DVec3::from(d).normalize(),
                length,
            })
    }

    proptest! {
        #[test]
        fn a_walk_meets_what_a_test_of_every_cell_finds(
            near in prop::collection::hash_set(prop::array::uniform3(-9..9i32), 0..900),
            far in prop::collection::hash_set(prop::array::uniform3(-70..70i32), 0..300),
            shift in prop::array::uniform3(-400_000_000..400_000_000i32),
            ray in any_ray(),
        ) {
            let shift = IVec3::from(shift);
            let mut cells: Vec<_> = near.union(&far).map(|c| IVec3::from(*c) + shift).collect();
            cells.sort_by_key(glam::IVec3::to_array);
            let tree = Tree::new(&leaves(&cells));
            let ray = Ray { base: ray.base + shift, ..ray };
            let (want, got) = (met(&cells, &ray), visited(&tree, &ray));
            prop_assert_eq!(got.len(), want.len(), "{:?} {:?}", got, want);
            for (got, want) in got.iter().zip(&want) {
                prop_assert!(got.0 == want.0 && (got.1 - want.1).abs() < 1e-6 && (got.2 - want.2).abs() < 1e-6);
            }
        }
    }

    proptest! {
        #[test]
        fn beams_stop_before_the_first_cell_of_any_of_their_rays(
            cells in prop::collection::hash_set(prop::array::uniform3(-40..40i32), 0..400),
            axis in any_ray(),
            spread in 0.001..0.6f64,
            offs in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 1..30),
        ) {
            let mut cells: Vec<_> = cells.iter().map(|c| IVec3::from(*c)).collect();
            cells.sort_by_key(glam::IVec3::to_array);
            let tree = Tree::new(&leaves(&cells));
            let towards = |off: &[f64; 3]| (axis.direction + DVec3::from(*off) * spread).normalize();
            let rays: Vec<_> = offs.iter().map(|off| Ray { direction: towards(off), length: 1e3, ..axis }).collect();
            let Some(beam) = Beam::about(axis.base, axis.origin, rays.iter().map(|ray| ray.direction)) else {
                return Ok(());
            };
            let start = tree.clear_length(&beam);
            for ray in rays {
                let late = Ray { start, ..ray };
                prop_assert_eq!(visited(&tree, &late).len(), visited(&tree, &ray).len(), "{}", start);
            }
            // And not much before: where the beam is a ray, it ends near cells.
            let narrow = Beam::about(axis.base, axis.origin, [axis.direction].into_iter());
            let clear = narrow.map_or(0.0, |beam| tree.clear_length(&beam));
            let ray = Ray { length: 1e3, ..axis };
            if let Some((_, enter, _)) = visited(&tree, &ray).first() {
                prop_assert!(clear <= *enter);
            }
        }
    }

    #[test]
    fn far_blocks_make_the_tree_high_and_the_walk_long_but_not_wrong() {
        let cells = [IVec3::ZERO, IVec3::splat(MAX_SPAN as i32 - 1)];
        let tree = Tree::new(&leaves(&cells));
        assert_eq!(tree.height, 15);
        for (from, towards) in [(cells[0], 1.0), (cells[1], -1.0)] {
            let ray = Ray {
                base: from,
                origin: DVec3::splat(0.5),
                direction: DVec3::splat(towards).normalize(),
                start: 0.0,
                depth_per_range: 1.0,
                length: f64::INFINITY,
            };
            let found = visited(&tree, &ray);
            assert_eq!(found.len(), 2, "{found:?}");
            assert_eq!(found[0].0, from);
        }
        assert!(visited(&Tree::new(&[]), &any_ray_at_zero()).is_empty());
    }

    fn any_ray_at_zero() -> Ray {
        Ray {
            base: IVec3::ZERO,
            origin: DVec3::ZERO,
            direction: DVec3::X,
            start: 0.0,
            depth_per_range: 1.0,
            length: 10.0,
        }
    }
}
