//! OctoMap's binary trees (`.bt`): which voxels are free and which are occupied, for ROS's planners.
//!
//! Two bits a child, from the root on; children that are all free or all occupied are one leaf. A tree has 16 levels: voxels from
//! −32,768 to 32,767 along each axis.

use std::io::{self, Write};
use std::path::Path;

use tsdfuse::glam::IVec3;

use crate::error::Result;

/// Levels below the root.
const LEVELS: u32 = 16;
/// Half the voxels along an axis.
const HALF: i32 = 1 << (LEVELS - 1);

/// Writes a tree of voxels with this edge, metres: each with whether it is occupied. The file appears when it is complete. If a
/// voxel is given twice, the last one counts.
///
/// # Errors
/// Names the file and what the system says; also if a voxel lies outside of the tree.
pub fn write(path: impl AsRef<Path>, voxel_size_m: f64, voxels: impl IntoIterator<Item = (IVec3, bool)>) -> Result<()> {
    crate::atomic::write(path, |out| write_to(out, voxel_size_m, voxels))
}

/// As [`write()`], to anything that takes bytes.
///
/// # Errors
/// What the system says; `InvalidInput` if a voxel lies outside of the tree.
pub fn write_to(
    mut out: impl Write,
    voxel_size_m: f64,
    voxels: impl IntoIterator<Item = (IVec3, bool)>,
) -> io::Result<()> {
    let keyed = |(voxel, is_occupied)| Some((key(voxel)?, is_occupied));
    let keyed: Option<Vec<(u64, bool)>> = voxels.into_iter().map(keyed).collect();
    let told = || {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            "a voxel lies outside of an octree of 16 levels",
        )
    };
    let mut keyed = keyed.ok_or_else(told)?;
    keyed.sort_by_key(|(key, _)| *key);
    // Of voxels told twice, the last one.
    keyed.reverse();
    keyed.dedup_by_key(|(key, _)| *key);
    keyed.reverse();
    let root = node(&keyed, LEVELS);
    write!(
        out,
        "# Octomap OcTree binary file\n# (feel free to add / change comments, but leave the first line as it is!)\n#\n\
         id OcTree\nsize {}\nres {voxel_size_m}\ndata\n",
        root.as_ref().map_or(0, size)
    )?;
    match &root {
        // A root that is a leaf cannot be told: it has all voxels there are.
        Some(root) => write_node(&mut out, root),
        None => Ok(()),
    }
}

/// A part of the tree.
enum Node {
    Leaf(bool),
    Inner(Box<[Option<Node>; 8]>),
}

/// The bits of all three coordinates, those of the highest level first: x is the lowest of three.
fn key(voxel: IVec3) -> Option<u64> {
    let shifted = voxel.checked_add(IVec3::splat(HALF))?;
    let is_inside = shifted.to_array().iter().all(|i| (0..2 * HALF).contains(i));
    let bits = |level: u32| {
        let bit = |i: i32, place: u32| ((i >> level & 1) as u64) << (3 * level + place);
        bit(shifted.x, 0) | bit(shifted.y, 1) | bit(shifted.z, 2)
    };
    is_inside.then(|| (0..LEVELS).map(bits).sum())
}

/// The part of the tree with these voxels, whose keys differ in the last `level` levels only.
fn node(voxels: &[(u64, bool)], level: u32) -> Option<Node> {
    let (_, first) = *voxels.first()?;
    if level == 0 {
        return Some(Node::Leaf(first));
    }
    let mut rest = voxels;
    let children: [Option<Node>; 8] = std::array::from_fn(|child| {
        let is_child = |(key, _): &(u64, bool)| (key >> (3 * (level - 1)) & 7) as usize == child;
        let (own, others) = rest.split_at(rest.partition_point(is_child));
        rest = others;
        node(own, level - 1)
    });
    let is_same = |child: &Option<Node>| matches!(child, Some(Node::Leaf(leaf)) if *leaf == first);
    if level < LEVELS && children.iter().all(is_same) {
        return Some(Node::Leaf(first));
    }
    Some(Node::Inner(Box::new(children)))
}

/// The number of nodes.
fn size(node: &Node) -> usize {
    match node {
        Node::Leaf(_) => 1,
        Node::Inner(children) => 1 + children.iter().flatten().map(size).sum::<usize>(),
    }
}

fn write_node(out: &mut impl Write, node: &Node) -> io::Result<()> {
    let Node::Inner(children) = node else {
        return Ok(());
    };
    let two_bits = |child: &Option<Node>| match child {
        None => 0b00,
        Some(Node::Leaf(false)) => 0b01,
        Some(Node::Leaf(true)) => 0b10,
        Some(Node::Inner(_)) => 0b11,
    };
    let bits = (0..).zip(children.iter()).map(|(i, child)| two_bits(child) << (2 * i));
    out.write_all(&bits.sum::<u16>().to_le_bytes())?;
    children.iter().flatten().try_for_each(|child| write_node(out, child))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    /// Reads a tree as its format says: the voxels of each leaf, level by level.
    fn read(bytes: &[u8]) -> (usize, BTreeMap<[i32; 3], bool>) {
        let marker = b"\ndata\n";
        let end = bytes.windows(marker.len()).position(|w| w == marker).unwrap() + marker.len();
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        let size = header.lines().find_map(|line| line.strip_prefix("size ")).unwrap();
        let (mut rest, mut voxels, mut nodes) = (&bytes[end..], BTreeMap::new(), 1);
        inner(&mut rest, [-HALF; 3], 2 * HALF, &mut voxels, &mut nodes);
        assert!(rest.is_empty() && size.parse() == Ok(nodes), "{size} {nodes}");
        (nodes, voxels)
    }

    fn inner(rest: &mut &[u8], low: [i32; 3], edge: i32, voxels: &mut BTreeMap<[i32; 3], bool>, nodes: &mut usize) {
        let (bits, after) = rest.split_first_chunk::<2>().unwrap();
        *rest = after;
        let half = edge / 2;
        for child in 0..8 {
            let corner = [0, 1, 2].map(|axis| low[axis] + half * (child >> axis & 1));
            let bits = bits[child as usize / 4] >> (2 * (child % 4)) & 3;
            *nodes += usize::from(bits > 0);
            match bits {
                3 => inner(rest, corner, half, voxels, nodes),
                0 => {}
                leaf => {
                    assert!(half <= 64, "leaves this large were not written");
                    for i in 0..half.pow(3) {
                        let at = [i % half, i / half % half, i / half / half];
                        let voxel = [0, 1, 2].map(|axis| corner[axis] + at[axis]);
                        assert_eq!(voxels.insert(voxel, leaf == 2), None);
                    }
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn what_is_written_is_read(
            some in prop::collection::vec((-9..9_i32, -9..9_i32, -9..9_i32, any::<bool>()), 1..400),
            far in (-HALF..HALF, -HALF..HALF, -HALF..HALF),
            full in any::<bool>(),
        ) {
            let mut expected = BTreeMap::new();
            if full {
                // Pruned to one leaf.
                expected.extend((0..8 * 8 * 8).map(|i| ([16 + i % 8, i / 8 % 8, -9 - i / 64], true)));
            }
            expected.insert([far.0, far.1, far.2], true);
            expected.extend(some.iter().map(|&(x, y, z, is_occupied)| ([x, y, z], is_occupied)));
            let mut bytes = Vec::new();
            write_to(&mut bytes, 0.2, expected.iter().map(|(voxel, state)| (IVec3::from(*voxel), *state))).unwrap();
            let (nodes, voxels) = read(&bytes);
            prop_assert_eq!(&voxels, &expected);
            prop_assert!(!full || nodes < expected.len() + 16 * (some.len() + 3));
        }
    }

    #[test]
    fn equal_voxels_are_one_leaf_and_the_last_word_counts() {
        let cube = |edge: i32| (0..edge.pow(3)).map(move |i| IVec3::new(i % edge, i / edge % edge, i / edge / edge));
        let mut bytes = Vec::new();
        let voxels = cube(32)
            .map(|voxel| (voxel, true))
            .chain(cube(32).map(|voxel| (voxel, false)));
        write_to(&mut bytes, 0.2, voxels).unwrap();
        let (nodes, voxels) = read(&bytes);
        // The root, one node a level, and the leaf of 32³ voxels.
        assert_eq!((nodes, voxels.len()), (12, 32 * 32 * 32));
        assert!(voxels.values().all(|is_occupied| !is_occupied));
    }

    #[test]
    fn what_lies_outside_of_a_tree_is_refused() {
        for outside in [HALF, -HALF - 1, i32::MAX, i32::MIN] {
            let told = write_to(Vec::new(), 0.2, [(IVec3::new(0, outside, 0), true)]).unwrap_err();
            assert!(told.to_string().contains("outside of an octree"), "{told}");
        }
        let mut empty = Vec::new();
        write_to(&mut empty, 0.2, []).unwrap();
        assert!(empty.ends_with(b"size 0\nres 0.2\ndata\n"));
    }
}
