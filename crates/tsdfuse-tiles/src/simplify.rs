//! A mesh of fewer triangles that is near the one it was made of.
//!
//! Edges are collapsed, the one that changes the surface least first (Garland and Heckbert 1997, as `meshopt` does it). Their measure of
//! error is a mean, so the result is measured, and what lies too far from it is put back.

use bytemuck::cast_slice;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify_with_locks};
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse_eval::Reference;

use crate::bounds::Bounds;
use crate::parts::without_specks;

/// A mesh of about `triangles` triangles, or of as many more as it takes: each vertex of `mesh` is no farther from it than the tolerance,
/// or belongs to a part of the surface that is no larger than that. Vertices are not moved; those to keep are kept.
pub(crate) fn simplified(mesh: &Mesh, triangles: usize, tolerance_m: f64, keep: impl Fn(DVec3) -> bool) -> Mesh {
    let keep_all = |mesh: &Mesh| mesh.vertices.iter().map(|v| keep(*v)).collect::<Vec<bool>>();
    let mesh = without_specks(mesh, &keep_all(mesh), tolerance_m);
    let kept = keep_all(&mesh);
    let mut few = collapsed(&mesh, triangles, &kept);
    let is_near = match Reference::mesh(compact(&mesh, &few)) {
        Ok(reference) => reference.are_within(&mesh.vertices, tolerance_m),
        // No triangle is left that has an area.
        Err(_) => vec![false; mesh.vertices.len()],
    };
    let is_lost = |corners: &&[u32; 3]| corners.iter().any(|v| !is_near[*v as usize]);
    few.extend(mesh.triangles.iter().filter(is_lost));
    let normals = normals(&mesh, &few, &kept);
    compact(&Mesh { normals, ..mesh }, &few)
}

/// Normals that fit larger triangles: the mean of those about each vertex, by area. Vertices that are kept look as they do elsewhere.
fn normals(mesh: &Mesh, triangles: &[[u32; 3]], kept: &[bool]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; mesh.vertices.len()];
    for corners in triangles {
        let [a, b, c] = corners.map(|v| mesh.vertices[v as usize]);
        let twice_area = (b - a).cross(c - a);
        corners.iter().for_each(|v| sums[*v as usize] += twice_area);
    }
    let both = sums.iter().zip(kept).zip(&mesh.normals);
    let normal = |((sum, kept), own): ((&DVec3, &bool), &Vec3)| match kept {
        true => *own,
        false => sum.try_normalize().map_or(*own, DVec3::as_vec3),
    };
    both.map(normal).collect()
}

/// Collapses edges between vertices that are not kept, until no more than `triangles` are left, or no edge. What is left of the triangles.
fn collapsed(mesh: &Mesh, triangles: usize, kept: &[bool]) -> Vec<[u32; 3]> {
    let middle = Bounds::of(&mesh.vertices).middle();
    let relative = |v: &DVec3| (v - middle).as_vec3().to_array();
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(relative).collect();
    let Ok(vertices) = VertexDataAdapter::new(cast_slice(&positions), size_of::<[f32; 3]>(), 0) else {
        // They are that long.
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

/// The mesh of some triangles, with no other vertices than theirs.
pub(crate) fn compact(mesh: &Mesh, triangles: &[[u32; 3]]) -> Mesh {
    let mut numbers = vec![u32::MAX; mesh.vertices.len()];
    let mut few = Mesh::default();
    for corners in triangles {
        let corners = corners.map(|v| {
            let number = &mut numbers[v as usize];
            if *number == u32::MAX {
                *number = few.vertices.len() as u32;
                few.vertices.push(mesh.vertices[v as usize]);
                few.normals.push(mesh.normals[v as usize]);
            }
            *number
        });
        few.triangles.push(corners);
    }
    few
}
