//! Connected components of a surface.

use tsdfuse::Mesh;

use crate::bounds::Bounds;
use crate::compact::compact;

/// Removes components that are no larger than `size_m` and have no vertex to keep.
pub(crate) fn without_specks(mesh: &Mesh, kept: &[bool], size_m: f64) -> Mesh {
    let parts = Parts::of(mesh);
    let mut bounds = vec![Bounds::NONE; mesh.vertices.len()];
    let mut stays = vec![false; mesh.vertices.len()];
    for (v, (position, kept)) in (0..).zip(mesh.vertices.iter().zip(kept)) {
        let part = parts.of_vertex(v) as usize;
        bounds[part].add(*position);
        stays[part] |= kept;
    }
    let stays = |[v, ..]: &&[u32; 3]| {
        let part = parts.of_vertex(*v) as usize;
        stays[part] || bounds[part].diagonal_m() > size_m
    };
    compact(mesh, &mesh.triangles.iter().filter(stays).copied().collect::<Vec<_>>())
}

/// Connected components as a forest of disjoint sets: for each vertex another vertex of its component, in the end the
/// lowest.
struct Parts(Vec<u32>);

impl Parts {
    fn of(mesh: &Mesh) -> Self {
        let mut parts = Self((0..mesh.vertices.len() as u32).collect());
        for &[a, b, c] in &mesh.triangles {
            parts.join(a, b);
            parts.join(b, c);
        }
        for v in 0..parts.0.len() {
            // Lower vertices are already resolved.
            parts.0[v] = parts.0[parts.0[v] as usize];
        }
        parts
    }

    /// The lowest vertex of a vertex's component.
    fn of_vertex(&self, v: u32) -> u32 {
        self.0[v as usize]
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.lowest(a), self.lowest(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// The lowest vertex so far; halves the path to it.
    fn lowest(&mut self, mut v: u32) -> u32 {
        while self.0[v as usize] != v {
            let next = self.0[self.0[v as usize] as usize];
            self.0[v as usize] = next;
            v = next;
        }
        v
    }
}
