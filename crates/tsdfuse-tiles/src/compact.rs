//! Leaving out unused vertices.

use tsdfuse::Mesh;

/// A mesh of some of the triangles, with only the vertices that they use.
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
