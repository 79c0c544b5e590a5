//! The 256 cases of marching cubes, derived instead of typed in.
//!
//! ```text
//!        6-------7         corner c sits at (c & 1, c >> 1 & 1, c >> 2 & 1)
//!       /|      /|
//!      4-------5 |         edge 4·axis + k runs along `axis` from the k-th corner (in order) whose bit `axis` is 0
//!      | 2-----|-3
//!      |/      |/          z  y
//!      0-------1           |/
//!                          +--x
//! ```
//!
//! On each face of the cube, every run of negative corners is cut off by one segment; so the two cells that share a face
//! always draw the same segments, and the surface has no cracks. The segments of the six faces form loops, which are cut into triangles.

use std::sync::LazyLock;

use super::distances::GridEdge;

/// The two corners of each edge, the lower first.
pub(super) const EDGE_CORNERS: [[usize; 2]; 12] = [
    [0, 1],
    [2, 3],
    [4, 5],
    [6, 7],
    [0, 2],
    [1, 3],
    [4, 6],
    [5, 7],
    [0, 4],
    [1, 5],
    [2, 6],
    [3, 7],
];

/// The corners of each face, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// The largest number of triangles in a cell.
pub(super) const MAX_TRIANGLES: usize = 5;

/// What to draw in a cell.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Case {
    /// How many triangles there are.
    pub(super) count: u8,
    /// Their corners, counter-clockwise seen from the positive side: each edge's number less that of the cell's first edge.
    pub(super) edges: [[u16; 3]; MAX_TRIANGLES],
}

/// For each set of negative corners (bit c for corner c), what to draw.
pub(super) static CASES: LazyLock<[Case; 256]> = LazyLock::new(|| {
    std::array::from_fn(|negative| {
        let mut case = Case::default();
        for (to, from) in case.edges.iter_mut().zip(triangles(negative)) {
            case.count += 1;
            *to = from.map(number_in_cell);
        }
        case
    })
});

/// The number of an edge of a cell less that of the cell's first edge.
fn number_in_cell(edge: u8) -> u16 {
    let number = |c: usize, axis| GridEdge::new([c & 1, c >> 1 & 1, c >> 2].map(|c| c as i32), axis).number();
    (number(EDGE_CORNERS[edge as usize][0], edge as usize / 4) - number(0, 0)) as u16
}

fn edge_between(a: usize, b: usize) -> usize {
    EDGE_CORNERS
        .iter()
        .position(|&[x, y]| (x, y) == (a.min(b), a.max(b)))
        .unwrap_or_default()
}

/// The triangles of a case, `negative` having bit c for each corner c behind the surface: three edges each, counter-clockwise
/// seen from the positive side. Edge 4·axis + k runs along `axis` from the k-th corner (c = x + 2y + 4z) whose bit `axis` is 0.
pub fn triangles(negative: usize) -> Vec<[u8; 3]> {
    let is_negative = |corner: usize| negative >> corner & 1 == 1;
    // The segment that follows each crossed edge on the way around the surface.
    let mut next = [None; 12];
    for face in FACES {
        for start in 0..4 {
            let (before, first) = (face[(start + 3) % 4], face[start]);
            if is_negative(first) && !is_negative(before) {
                let length = (1..4).take_while(|&k| is_negative(face[(start + k) % 4])).count();
                let (last, after) = (face[(start + length) % 4], face[(start + length + 1) % 4]);
                next[edge_between(before, first)] = Some(edge_between(last, after));
            }
        }
    }
    let mut triangles = Vec::new();
    for first in 0..12 {
        let mut polygon = Vec::new();
        let mut edge = first;
        while let Some(following) = next[edge].take() {
            polygon.push(edge as u8);
            edge = following;
        }
        triangles.extend(fan(&polygon));
    }
    triangles
}

/// Cuts a polygon into a fan around one of its corners: the first one for which no cut lies in a face of the cube. (A cut in a
/// face might be made by the neighbouring cell too, and four triangles would meet there.)
fn fan(polygon: &[u8]) -> Vec<[u8; 3]> {
    let n = polygon.len();
    let at = |apex: usize, k: usize| polygon[(apex + k) % n];
    let apex = (0..n)
        .find(|&apex| (2..n - 1).all(|k| !share_face(at(apex, 0), at(apex, k))))
        .unwrap_or_default();
    (2..n).map(|k| [at(apex, 0), at(apex, k - 1), at(apex, k)]).collect()
}

/// Whether two edges lie in the same face of the cube.
fn share_face(a: u8, b: u8) -> bool {
    let corners = |edge: u8| EDGE_CORNERS[edge as usize];
    FACES
        .iter()
        .any(|face| corners(a).iter().chain(&corners(b)).all(|c| face.contains(c)))
}

#[cfg(test)]
mod tests {
    use super::*;

    static TRIANGLES: LazyLock<[Vec<[u8; 3]>; 256]> = LazyLock::new(|| std::array::from_fn(triangles));

    #[test]
    fn all_triangles_are_drawn() {
        for (case, triangles) in CASES.iter().zip(TRIANGLES.iter()) {
            assert_eq!(case.count as usize, triangles.len());
            for (drawn, edges) in case.edges.iter().zip(triangles) {
                assert_eq!(*drawn, edges.map(number_in_cell));
            }
        }
    }

    #[test]
    fn every_crossed_edge_is_used_and_no_other() {
        for (case, triangles) in TRIANGLES.iter().enumerate() {
            for (edge, [a, b]) in EDGE_CORNERS.iter().enumerate() {
                let crossed = (case >> a & 1) != (case >> b & 1);
                assert_eq!(
                    triangles.iter().flatten().any(|&e| e as usize == edge),
                    crossed,
                    "case {case} edge {edge}"
                );
            }
        }
    }

    #[test]
    fn one_negative_corner_gives_one_triangle_facing_away_from_it() {
        // Edges along x, y and z from corner 0: counter-clockwise seen from (1, 1, 1).
        let t = TRIANGLES[1][0];
        assert_eq!(TRIANGLES[1].len(), 1);
        let start = t.iter().position(|&e| e == 0).unwrap();
        assert_eq!([t[start], t[(start + 1) % 3], t[(start + 2) % 3]], [0, 4, 8]);
    }

    #[test]
    fn borders_of_all_cases_lie_on_faces_and_run_once() {
        for (case, triangles) in TRIANGLES.iter().enumerate() {
            let mut directed: Vec<(u8, u8)> = triangles
                .iter()
                .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
                .collect();
            let all = directed.clone();
            directed.retain(|&(a, b)| !all.contains(&(b, a)));
            for (a, b) in directed {
                let corners = |e: u8| EDGE_CORNERS[e as usize];
                let on_one_face = FACES
                    .iter()
                    .any(|f| corners(a).iter().chain(&corners(b)).all(|c| f.contains(c)));
                assert!(on_one_face, "case {case}: the border {a} {b} crosses the cell");
            }
        }
    }
}
