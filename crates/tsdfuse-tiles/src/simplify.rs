//! Simplifying a mesh within a tolerance.
//!
//! Edges are collapsed, starting with the one that changes the surface least (Garland and Heckbert 1997, as implemented
//! by `meshopt`). Its error measure is a mean, so the result is measured, and triangles whose vertices ended up too far
//! from it are put back.

use bytemuck::cast_slice;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify_with_locks};
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use crate::bounds::Bounds;
use crate::compact::compact;
use crate::near::are_within;
use crate::parts::without_specks;

/// A mesh of about `triangles` triangles, or of more if the tolerance needs them. Every vertex of `mesh` is within the
/// tolerance of the result, unless it belongs to a component of the surface that is smaller than the tolerance. No
/// vertex moves, and vertices to `keep` are kept.
pub(crate) fn simplified(mesh: &Mesh, triangles: usize, tolerance_m: f64, keep: impl Fn(DVec3) -> bool) -> Mesh {
    let keep_all = |mesh: &Mesh| mesh.vertices.iter().map(|v| keep(*v)).collect::<Vec<bool>>();
    let mesh = without_specks(mesh, &keep_all(mesh), tolerance_m);
    let kept = keep_all(&mesh);
    let mut few = collapsed(&mesh, triangles, &kept);
    let is_near = are_within(&compact(&mesh, &few), &mesh.vertices, tolerance_m);
    let is_lost = |corners: &&[u32; 3]| corners.iter().any(|v| !is_near[*v as usize]);
    few.extend(mesh.triangles.iter().filter(is_lost));
    let normals = normals(&mesh, &few, &kept);
    compact(&Mesh { normals, ..mesh }, &few)
}

/// Normals for larger triangles: the mean of the triangles around each vertex, weighted by area. Kept vertices keep
/// their normals, so that they look the same in the tile next to this one.
fn normals(mesh: &Mesh, triangles: &[[u32; 3]], kept: &[bool]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; mesh.vertices.len()];
    for corners in triangles {
        let [a, b, c] = corners.map(|v| mesh.vertices[v as usize]);
        let twice_area = (b - a).cross(c - a);
        corners.iter().for_each(|v| sums[*v as usize] += twice_area);
    }
    let both = sums.iter().zip(kept).zip(&mesh.normals);
    let normal = |((sum, kept), own): ((&DVec3, &bool), &Vec3)| {
        if *kept {
            *own
        } else {
            sum.try_normalize().map_or(*own, DVec3::as_vec3)
        }
    };
    both.map(normal).collect()
}

/// Collapses edges between vertices that are not kept, until at most `triangles` triangles or no such edges are left.
/// Returns the triangles.
fn collapsed(mesh: &Mesh, triangles: usize, kept: &[bool]) -> Vec<[u32; 3]> {
    let middle = Bounds::of(&mesh.vertices).middle();
    let relative = |v: &DVec3| (v - middle).as_vec3().to_array();
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(relative).collect();
    let Ok(vertices) = VertexDataAdapter::new(cast_slice(&positions), size_of::<[f32; 3]>(), 0) else {
        // Unreachable: the stride is that of the positions.
        return mesh.triangles.clone();
    };
    let corners = simplify_with_locks(
        mesh.triangles.as_flattened(),
        &vertices,
        kept,
        3 * triangles.min(mesh.triangles.len()),
        f32::MAX,
        SimplifyOptions::None,
        None,
    );
    corners.as_chunks().0.to_vec()
}
