//! A surface of fewer triangles: vertices that share a cell of a grid become one (Rossignac and Borrel 1993).

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, Vec3};

use crate::scene::{Channel, Paint, Surface};

/// A mesh and what is known of its vertices, of its own.
pub(crate) struct Owned {
    mesh: Mesh,
    colors: Vec<[u8; 3]>,
    channels: Vec<(Channel, Vec<f32>)>,
}

impl Owned {
    pub(crate) fn with<T>(&self, look: impl FnOnce(&Surface<'_>) -> T) -> T {
        let channels: Vec<_> = self
            .channels
            .iter()
            .map(|(channel, values)| (channel.clone(), values.as_slice()))
            .collect();
        let paint = Paint {
            colors: &self.colors,
            channels: &channels,
        };
        look(&Surface {
            mesh: &self.mesh,
            paint,
        })
    }
}

/// A surface of at most `most` triangles, in the finest of a row of grids, each a quarter wider than the one before.
pub(crate) fn clustered(surface: &Surface<'_>, low: DVec3, most: usize) -> Owned {
    let mesh = surface.mesh;
    // Cells of the mean edge join few vertices; a surface then has a triangle or two a cell.
    let edge = |&[a, b, _]: &[u32; 3]| (mesh.vertices[a as usize] - mesh.vertices[b as usize]).length();
    let sampled = mesh.triangles.iter().step_by(mesh.triangles.len() / 1000 + 1);
    let (sum, count) = sampled
        .map(edge)
        .fold((0.0, 0.0), |(sum, count), edge| (sum + edge, count + 1.0));
    let mut cell_m = sum / f64::max(count, 1.0);
    loop {
        let joined = joined(mesh, low, cell_m);
        if joined.triangles.len() <= most {
            return mean(surface, joined);
        }
        cell_m = if cell_m > 0.0 { 1.25 * cell_m } else { 1e-3 };
    }
}

/// Which vertices become which.
struct Joined {
    /// Of each vertex.
    numbers: Vec<u32>,
    count: usize,
    triangles: Vec<[u32; 3]>,
}

fn joined(mesh: &Mesh, low: DVec3, cell_m: f64) -> Joined {
    let cell = |vertex: &DVec3| ((*vertex - low) / cell_m).floor().as_ivec3().to_array();
    let mut cells: Vec<([i32; 3], u32)> = mesh
        .vertices
        .par_iter()
        .map(cell)
        .zip(0..mesh.vertices.len() as u32)
        .collect();
    cells.par_sort_unstable();
    let (mut numbers, mut count) = (vec![0; mesh.vertices.len()], 0);
    for group in cells.chunk_by(|a, b| a.0 == b.0) {
        group.iter().for_each(|&(_, vertex)| numbers[vertex as usize] = count);
        count += 1;
    }
    let renumbered = mesh
        .triangles
        .par_iter()
        .map(|corners| corners.map(|v| numbers[v as usize]));
    let mut triangles: Vec<[u32; 3]> = renumbered.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    // One of those with the same corners is enough; they begin with the lowest one.
    triangles.par_iter_mut().for_each(|[a, b, c]| {
        while *a > *b || *a > *c {
            (*a, *b, *c) = (*b, *c, *a);
        }
    });
    triangles.par_sort_unstable();
    triangles.dedup();
    Joined {
        numbers,
        count: count as usize,
        triangles,
    }
}

/// Each new vertex is the mean of its vertices.
fn mean(
    surface: &Surface<'_>,
    Joined {
        numbers,
        count,
        triangles,
    }: Joined,
) -> Owned {
    let (mesh, paint) = (surface.mesh, &surface.paint);
    let mut sums = vec![(DVec3::ZERO, Vec3::ZERO, 0.0_f64); count];
    for ((&number, vertex), normal) in numbers.iter().zip(&mesh.vertices).zip(&mesh.normals) {
        let sum = &mut sums[number as usize];
        *sum = (sum.0 + vertex, sum.1 + normal, sum.2 + 1.0);
    }
    let mean_of = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let mut all = vec![0.0; count];
        numbers
            .iter()
            .enumerate()
            .for_each(|(vertex, &number)| all[number as usize] += value(vertex));
        all.iter().zip(&sums).map(|(sum, (_, _, n))| sum / n).collect()
    };
    let colors = match paint.colors.is_empty() {
        true => Vec::new(),
        false => {
            let [r, g, b] = [0, 1, 2].map(|band| mean_of(&|vertex| f64::from(paint.colors[vertex][band])));
            (0..count)
                .map(|i| [r[i], g[i], b[i]].map(|x| x.round() as u8))
                .collect()
        }
    };
    let channel = |(channel, values): &(Channel, &[f32])| {
        let means = mean_of(&|vertex| f64::from(values[vertex]));
        (channel.clone(), means.into_iter().map(|mean| mean as f32).collect())
    };
    Owned {
        mesh: Mesh {
            vertices: sums.iter().map(|(place, _, n)| *place / *n).collect(),
            normals: sums.iter().map(|(_, normal, _)| normal.normalize_or(Vec3::Z)).collect(),
            triangles,
        },
        colors,
        channels: paint.channels.iter().map(channel).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fewer_triangles_lie_where_the_surface_was() {
        let n = 200_u32;
        let place = |i: u32| {
            let (x, y) = (f64::from(i % n) * 0.05, f64::from(i / n) * 0.05);
            DVec3::new(x, y, 0.3 * x)
        };
        let quads = (0..(n - 1) * (n - 1)).map(|i| i % (n - 1) + i / (n - 1) * n);
        let mesh = Mesh {
            vertices: (0..n * n).map(place).collect(),
            normals: vec![Vec3::Z; (n * n) as usize],
            triangles: quads
                .flat_map(|i| [[i, i + 1, i + n], [i + 1, i + n + 1, i + n]])
                .collect(),
        };
        let reds: Vec<[u8; 3]> = mesh.vertices.iter().map(|v| [(25.0 * v.x) as u8, 0, 9]).collect();
        let paint = Paint {
            colors: &reds,
            channels: &[],
        };
        let few = clustered(&Surface { mesh: &mesh, paint }, DVec3::ZERO, 20_000);
        let count = few.mesh.triangles.len();
        assert!((8_000..=20_000).contains(&count), "{count}");
        let area = |mesh: &Mesh| -> f64 {
            let corners = mesh
                .triangles
                .iter()
                .map(|corners| corners.map(|v| mesh.vertices[v as usize]));
            corners.map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum()
        };
        assert!((area(&few.mesh) / area(&mesh) - 1.0).abs() < 0.03);
        for (vertex, color) in few.mesh.vertices.iter().zip(&few.colors) {
            assert!((vertex.z - 0.3 * vertex.x).abs() < 1e-9);
            assert!((f64::from(color[0]) - 25.0 * vertex.x).abs() < 3.0 && color[2] == 9);
        }
        // Orientation stays.
        let up = few.mesh.triangles.iter().all(|corners| {
            let [a, b, c] = corners.map(|v| few.mesh.vertices[v as usize]);
            (b - a).cross(c - a).z > 0.0
        });
        assert!(up);
    }
}
