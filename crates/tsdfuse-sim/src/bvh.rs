//! A bounding-volume hierarchy over the primitives of a scene.
//!
//! A binary tree in one array, depth first: a node's left child follows it, the right one stands at `right`. Leaves hold one
//! primitive each, and primitives are kept in the order of their leaves. Splits minimise the surface area heuristic
//! (MacDonald & Booth 1990) over all positions on all three axes.

use glam::DVec3;

use crate::primitive::{Aabb, Entry, Primitive, Ray};

#[derive(Clone, Debug)]
struct Node {
    bounds: Aabb,
    link: Link,
}

#[derive(Clone, Copy, Debug)]
enum Link {
    /// Number of the primitive.
    Leaf(u32),
    /// Number of the right child.
    Right(u32),
}

/// The tree and the primitives in its order.
#[derive(Clone, Debug)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    primitives: Vec<Primitive>,
}

struct Item {
    bounds: Aabb,
    primitive: Primitive,
}

/// The nodes to visit, with the least value that their primitives can have.
type Stack = Vec<(u32, f64)>;

impl Bvh {
    pub(crate) fn new(primitives: Vec<Primitive>) -> Self {
        let mut items: Vec<_> = primitives
            .into_iter()
            .map(|primitive| Item {
                bounds: primitive.bounds(),
                primitive,
            })
            .collect();
        let mut nodes = Vec::with_capacity(2 * items.len());
        if !items.is_empty() {
            build(&mut items, 0, &mut nodes);
        }
        let primitives = items.into_iter().map(|i| i.primitive).collect();
        Self { nodes, primitives }
    }

    pub(crate) fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    pub(crate) fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, |n| n.bounds)
    }

    /// The first solid a ray of unit direction enters, and its number.
    pub(crate) fn cast(&self, origin: DVec3, direction: DVec3) -> Option<(Entry, usize)> {
        let ray = Ray::new(origin, direction, 0.0);
        let mut best: Option<(Entry, usize)> = None;
        let start = |n: &Node| {
            let (near, far) = n.bounds.span(&ray);
            // A face seen edge on has no thickness: let rounding pass.
            if near <= far + 1e-9 { near } else { f64::INFINITY }
        };
        self.visit(f64::INFINITY, start, |number, nearest| {
            if let Some(entry) = self.primitives[number].enter(origin, direction)
                && entry.t > 0.0
                && entry.t < *nearest
            {
                *nearest = entry.t;
                best = Some((entry, number));
            }
        });
        best
    }

    /// The least signed distance to any primitive; infinite if there are none.
    pub(crate) fn signed_distance(&self, point: DVec3) -> f64 {
        let mut least = f64::INFINITY;
        self.visit(
            least,
            |n| n.bounds.distance(point),
            |number, nearest| {
                *nearest = nearest.min(self.primitives[number].signed_distance(point));
                least = *nearest;
            },
        );
        least
    }

    /// Visits leaves that can lie below `limit`, the nearer child first; `leaf` lowers the limit.
    fn visit(&self, mut limit: f64, bound: impl Fn(&Node) -> f64, mut leaf: impl FnMut(usize, &mut f64)) {
        let mut stack: Stack = Vec::with_capacity(64);
        if let Some(root) = self.nodes.first() {
            stack.push((0, bound(root)));
        }
        while let Some((mut number, mut least)) = stack.pop() {
            while least < limit {
                let right = match self.nodes[number as usize].link {
                    Link::Leaf(primitive) => {
                        leaf(primitive as usize, &mut limit);
                        break;
                    }
                    Link::Right(right) => right,
                };
                let left = number + 1;
                let children = [left, right].map(|n| (n, bound(&self.nodes[n as usize])));
                let [mut near, mut far] = children;
                if far.1 < near.1 {
                    (near, far) = (far, near);
                }
                if far.1 < limit {
                    stack.push(far);
                }
                (number, least) = near;
            }
        }
    }
}

/// Appends the tree over `items`, the first of which is primitive `first`; returns its bounds.
fn build(items: &mut [Item], first: u32, nodes: &mut Vec<Node>) -> Aabb {
    let number = nodes.len();
    let bounds = items.iter().fold(Aabb::EMPTY, |b, i| b.union(&i.bounds));
    nodes.push(Node {
        bounds,
        link: Link::Leaf(first),
    });
    if items.len() > 1 {
        let (axis, at) = best_split(items);
        sort(items, axis);
        let (left, right) = items.split_at_mut(at);
        build(left, first, nodes);
        nodes[number].link = Link::Right(nodes.len() as u32);
        build(right, first + at as u32, nodes);
    }
    bounds
}

fn sort(items: &mut [Item], axis: usize) {
    items.sort_by(|a, b| a.bounds.centre()[axis].total_cmp(&b.bounds.centre()[axis]));
}

/// The axis of the best split (the least Σ area × number), and how many primitives go left.
fn best_split(items: &mut [Item]) -> (usize, usize) {
    let mut best = (f64::INFINITY, 0, items.len() / 2);
    for axis in 0..3 {
        sort(items, axis);
        let areas = |items: &mut dyn Iterator<Item = &Item>| -> Vec<f64> {
            let grown = items.scan(Aabb::EMPTY, |b, i| {
                *b = b.union(&i.bounds);
                Some(b.half_area())
            });
            grown.collect()
        };
        let (from_left, from_right) = (areas(&mut items.iter()), areas(&mut items.iter().rev()));
        for left in 1..items.len() {
            let right = items.len() - left;
            let cost = from_left[left - 1] * left as f64 + from_right[right - 1] * right as f64;
            if cost < best.0 {
                best = (cost, axis, left);
            }
        }
    }
    (best.1, best.2)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::objects::Rng;

    fn random(rng: &mut Rng, size: DVec3) -> DVec3 {
        size * DVec3::from([(); 3].map(|()| rng.random_range(-1.0..1.0)))
    }

    /// Points anywhere in the street, and rays from within the space that is free of houses.
    #[test]
    fn finds_what_a_search_through_all_finds() {
        let scene = crate::scene::by_name("street", 3).unwrap();
        let solids = scene.primitives();
        let mut rng = Rng::seed_from_u64(1);
        for _ in 0..1000 {
            let p = random(&mut rng, DVec3::new(70.0, 30.0, 10.0));
            let least = solids
                .iter()
                .map(|s| s.signed_distance(p))
                .fold(f64::INFINITY, f64::min);
            assert_eq!(scene.signed_distance(p), least);

            let origin = random(&mut rng, DVec3::new(50.0, 9.0, 3.0)) + DVec3::Z * 5.0;
            let direction = random(&mut rng, DVec3::ONE).normalize();
            let entries = solids.iter().filter_map(|s| s.enter(origin, direction));
            let first = entries.map(|e| e.t).filter(|&t| t > 0.0).min_by(f64::total_cmp);
            assert_eq!(scene.cast_local(origin, direction).map(|h| h.range_m), first);
        }
    }

    #[test]
    fn nothing_is_far_and_unseen() {
        let bvh = Bvh::new(Vec::new());
        assert_eq!(bvh.signed_distance(DVec3::ZERO), f64::INFINITY);
        assert!(bvh.cast(DVec3::ZERO, DVec3::X).is_none());
    }
}
