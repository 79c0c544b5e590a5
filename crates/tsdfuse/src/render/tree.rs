//! Where the surface is: a tree whose nodes have 4×4×4 children, one bit each.
//!
//! A *cell* is the cube between eight neighbouring voxel centres; cell c begins at the centre of voxel c. The tree knows the
//! cells that the surface passes and nothing else, so a ray crosses empty space in steps of 4, 16, 64, … voxels:
//!
//! ```text
//!   level 2: 64 voxels   │         ray ─────────────────────────▶ │ ░░ │
//!   level 1: 16 voxels                                              │ ─▶ │ ░░ │
//!   level 0:  4 voxels                                                      │ ▶ │▒▒│    children of a leaf: cells
//!
//!   number of a child in its node: x + 4 y + 16 z  (two bits of each coordinate)
//! ```

use glam::{DVec3, IVec3};

/// Cells that one tree can span along each axis, a power of 4: 53 000 km at 5 cm.
pub(super) const MAX_SPAN: i64 = 1 << 30;

/// The cells with surface.
#[derive(Debug, Default)]
pub(super) struct Tree {
    /// The cell with the lowest coordinates.
    pub(super) first: IVec3,
    /// Levels from the leaves, whose children are cells, to the root.
    pub(super) height: usize,
    /// The root, the level below, …, the leaves. Siblings are neighbours.
    pub(super) nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Which children there are.
    pub(super) children: u64,
    /// The number of the first child; of the block in a leaf.
    pub(super) first: u32,
}

/// 4×4×4 cells of one block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaf {
    /// The cell with the lowest coordinates, a multiple of 4.
    pub(super) cell: IVec3,
    /// The cells with surface; at least one.
    pub(super) cells: u64,
    /// What a visitor is told.
    pub(super) block: u32,
}

/// Rays from one place in a cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    /// The cell that `origin` is relative to.
    base: IVec3,
    /// Where it begins, cells.
    origin: DVec3,
    /// Unit vector.
    axis: DVec3,
    /// Cosine and sine of the largest angle between a ray and the axis.
    cos: f64,
    sin: f64,
}

impl Beam {
    /// The cone about some directions (unit vectors); `None` if it is wide.
    pub(super) fn about(base: IVec3, origin: DVec3, directions: impl Iterator<Item = DVec3> + Clone) -> Option<Self> {
        let axis = directions.clone().sum::<DVec3>().normalize_or_zero();
        let cos = directions.map(|d| d.dot(axis)).fold(1.0, f64::min) - 1e-9;
        (cos > 0.5).then(|| Self {
            base,
            origin,
            axis,
            cos,
            sin: (1.0 - cos * cos).max(0.0).sqrt(),
        })
    }
}

impl Tree {
    /// A tree of leaves that span at most [`MAX_SPAN`].
    pub(super) fn new(leaves: &[Leaf]) -> Self {
        let Some(first) = leaves.iter().map(|leaf| leaf.cell).reduce(IVec3::min) else {
            return Self::default();
        };
        let node = |leaf: &Leaf| {
            let node = Node {
                children: leaf.cells,
                first: leaf.block,
            };
            (path((leaf.cell - first) >> 2), node)
        };
        let mut nodes: Vec<(u128, Node)> = leaves.iter().map(node).collect();
        nodes.sort_unstable_by_key(|(path, _)| *path);
        let mut levels = vec![nodes];
        while let Some(nodes) = levels.last().filter(|nodes| nodes.len() > 1) {
            let mut parents: Vec<(u128, Node)> = Vec::new();
            let mut first = 0;
            for siblings in nodes.chunk_by(|a, b| a.0 >> 6 == b.0 >> 6) {
                let children = siblings.iter().fold(0, |all, (path, _)| all | 1 << (path & 63));
                parents.push((siblings[0].0 >> 6, Node { children, first }));
                first += siblings.len() as u32;
            }
            levels.push(parents);
        }
        let height = levels.len();
        let mut nodes: Vec<Node> = Vec::with_capacity(levels.iter().map(Vec::len).sum());
        for (level, of_level) in levels.into_iter().enumerate().rev() {
            // The level below comes right behind.
            let shift = if level > 0 {
                (nodes.len() + of_level.len()) as u32
            } else {
                0
            };
            nodes.extend(of_level.into_iter().map(|(_, n)| Node {
                first: n.first + shift,
                ..n
            }));
        }
        Self { first, height, nodes }
    }

    /// Whether rays from this cell stay within 32 bits.
    pub(super) fn reaches(&self, base: IVec3) -> bool {
        (base.as_i64vec3() - self.first.as_i64vec3()).abs().max_element() < MAX_SPAN
    }

    /// How far the rays of a beam go before the first of them can reach a cell with surface, cells; infinite if none ever does.
    pub(super) fn clear_length(&self, beam: &Beam) -> f64 {
        let mut clear = f64::INFINITY;
        if let Some(top) = self.height.checked_sub(1) {
            let first = (self.first - beam.base).as_dvec3() - beam.origin;
            self.approach(beam, 0, top, first, &mut clear);
        }
        clear
    }

    /// Shortens `clear` to what the children of a node, whose first cell begins at `corner` from the beam's origin, leave of it.
    fn approach(&self, beam: &Beam, node: u32, level: usize, corner: DVec3, clear: &mut f64) {
        let node = self.nodes[node as usize];
        let edge = f64::from(1 << (2 * level as i32));
        let radius = edge * (0.5 * 3.0_f64.sqrt());
        let mut children = node.children;
        for number in node.first.. {
            if children == 0 {
                break;
            }
            let child = children.trailing_zeros() as i32;
            children &= children - 1;
            let low = corner + IVec3::new(child & 3, child >> 2 & 3, child >> 4).as_dvec3() * edge;
            let center = low + 0.5 * edge;
            let (distance2, along) = (center.length_squared(), center.dot(beam.axis));
            let beside = (distance2 - along * along).max(0.0).sqrt() * beam.cos - along * beam.sin;
            let length = distance2.sqrt() - radius;
            if beside > radius || length >= *clear {
                continue;
            }
            match level {
                0 | 1 => *clear = length.max(0.0),
                _ => self.approach(beam, number, level - 1, low, clear),
            }
        }
    }
}

/// The number of the child that holds a cell, given by its coordinates in units of the child's edge.
#[inline]
pub(super) fn child_number(cell: IVec3) -> u32 {
    let c = cell & 3;
    (c.x | c.y << 2 | c.z << 4) as u32
}

/// The child numbers from the root down, 6 bits each: orders siblings next to each other.
fn path(leaf: IVec3) -> u128 {
    (0..15).fold(0, |path, level| {
        path | u128::from(child_number(leaf >> (2 * level))) << (6 * level)
    })
}
