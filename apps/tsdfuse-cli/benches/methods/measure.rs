//! How far a mesh is from the true surface, and how much of the true surface it covers.

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, IVec3};

/// Distances of a mesh to the true surface, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accuracy {
    pub(crate) mean_m: f64,
    pub(crate) rmse_m: f64,
    /// 95 of 100 samples are at most this far away.
    pub(crate) p95_m: f64,
    /// Share of the samples within the tolerance.
    pub(crate) precision: f64,
}

/// Measures `samples` points of the mesh with the signed distance to the true surface; `None` for a mesh without area.
pub(crate) fn accuracy(
    mesh: &Mesh,
    samples: usize,
    tolerance_m: f64,
    signed_distance: impl Fn(DVec3) -> f64 + Sync,
) -> Option<Accuracy> {
    let points = samples_by_area(mesh, samples);
    let mut errors: Vec<f64> = points.par_iter().map(|&p| signed_distance(p).abs()).collect();
    errors.par_sort_unstable_by(f64::total_cmp);
    let n = errors.len() as f64;
    Some(Accuracy {
        mean_m: errors.iter().sum::<f64>() / n,
        rmse_m: (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
        p95_m: *errors.get(errors.len() * 95 / 100)?,
        precision: errors.partition_point(|&e| e <= tolerance_m) as f64 / n,
    })
}

/// `count` points spread evenly over the area: one per equal share of it, in the order of the triangles, within a triangle by
/// Roberts's R2 sequence. Always the same ones.
fn samples_by_area(mesh: &Mesh, count: usize) -> Vec<DVec3> {
    let corners = |t: &[u32; 3]| t.map(|v| mesh.vertices[v as usize]);
    let ends: Vec<f64> = mesh
        .triangles
        .iter()
        .scan(0.0, |sum, t| {
            let [a, b, c] = corners(t);
            *sum += (b - a).cross(c - a).length() / 2.0;
            Some(*sum)
        })
        .collect();
    let total = ends.last().copied().unwrap_or(0.0);
    let point = |i: usize| {
        let at = (i as f64 + 0.5) / count as f64 * total;
        let [a, b, c] = corners(mesh.triangles.get(ends.partition_point(|&end| end <= at))?);
        let [u, v] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3].map(|step| (0.5 + step * i as f64).fract());
        let root = u.sqrt();
        Some(a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v))
    };
    (0..count).filter_map(point).collect()
}

/// The share of `truth`, points on the true surface, that lies within `tolerance_m` of the mesh: exact distances to triangles.
pub(crate) fn completeness(mesh: &Mesh, truth: &[DVec3], tolerance_m: f64) -> f64 {
    let triangles = Triangles::new(mesh, tolerance_m);
    let covered = truth.par_iter().filter(|&&p| triangles.near(p)).count();
    covered as f64 / truth.len() as f64
}

/// The triangles of a mesh by the cells that their boxes touch, at most eight each.
struct Triangles<'a> {
    mesh: &'a Mesh,
    tolerance_m: f64,
    /// Edge of a cell: the tolerance, or the longest edge of a triangle's box if that is more.
    edge_m: f64,
    /// Sorted.
    entries: Vec<(Cell, u32)>,
}

/// Number of a cell of a regular grid.
pub(crate) type Cell = [i32; 3];

/// The cell of edge `edge_m` that holds a point.
pub(crate) fn cell(point: DVec3, edge_m: f64) -> Cell {
    (point / edge_m).floor().as_ivec3().to_array()
}

impl<'a> Triangles<'a> {
    fn new(mesh: &'a Mesh, tolerance_m: f64) -> Self {
        let bounds = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
            [a.min(b).min(c), a.max(b).max(c)]
        };
        let longest = |t| {
            let [low, high] = bounds(t);
            (high - low).max_element()
        };
        let edge_m = mesh.triangles.iter().map(longest).fold(tolerance_m, f64::max);
        let cells = |(number, t): (usize, &[u32; 3])| {
            let [low, high] = bounds(t).map(|corner| cell(corner, edge_m));
            let rows = (low[0]..=high[0]).flat_map(move |x| (low[1]..=high[1]).map(move |y| (x, y)));
            rows.flat_map(move |(x, y)| (low[2]..=high[2]).map(move |z| ([x, y, z], number as u32)))
        };
        let mut entries: Vec<(Cell, u32)> = mesh.triangles.par_iter().enumerate().flat_map_iter(cells).collect();
        entries.par_sort_unstable();
        Self {
            mesh,
            tolerance_m,
            edge_m,
            entries,
        }
    }

    /// Whether a triangle lies within the tolerance of `p`.
    fn near(&self, p: DVec3) -> bool {
        let home = IVec3::from(cell(p, self.edge_m));
        // Its own cell first, where the answer almost always is.
        let around = [0, -1, 1];
        around.iter().any(|&x| {
            around.iter().any(|&y| {
                around.iter().any(|&z| {
                    let wanted = (home + IVec3::new(x, y, z)).to_array();
                    let start = self.entries.partition_point(|(cell, _)| *cell < wanted);
                    let here = self.entries[start..].iter().take_while(|(cell, _)| *cell == wanted);
                    here.map(|&(_, t)| self.mesh.triangles[t as usize].map(|v| self.mesh.vertices[v as usize]))
                        .any(|t| closest_on(t, p).distance_squared(p) <= self.tolerance_m * self.tolerance_m)
                })
            })
        })
    }
}

/// The point of a triangle that is nearest to `p` (Ericson, Real-Time Collision Detection, 2005, 5.1.5).
pub(crate) fn closest_on([a, b, c]: [DVec3; 3], p: DVec3) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let [d1, d2] = [ab.dot(p - a), ac.dot(p - a)];
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let [d3, d4] = [ab.dot(p - b), ac.dot(p - b)];
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let [d5, d6] = [ab.dot(p - c), ac.dot(p - c)];
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    a + (ab * vb + ac * vc) / (va + vb + vc)
}
