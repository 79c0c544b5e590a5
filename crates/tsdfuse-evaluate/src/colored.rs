//! Meshes in the colours of their distances to a reference.

use std::path::Path;

use tsdfuse::Mesh;
use tsdfuse_eval::{Reference, color};
use tsdfuse_view::{Channel, Paint, Ramp, Scene, Surface, add_normals, page};

/// The colour of each vertex's distance to the reference: dark blue at 0, yellow from `max_error_m` on.
pub fn by_distance(mesh: &Mesh, reference: &Reference, max_error_m: f64) -> Vec<[u8; 3]> {
    let distances = reference.distances(&mesh.vertices).into_iter();
    distances
        .map(|distance_m| color::of_distance(distance_m, max_error_m))
        .collect()
}

/// Whether [`write()`] can write to such a file: `.ply`, `.glb` or `.html`.
///
/// # Errors
/// Names the file and what is possible.
pub fn check(path: &Path) -> tsdfuse_io::Result<()> {
    if page::is_page(path) {
        Ok(())
    } else {
        tsdfuse_io::mesh::check_colored(path)
    }
}

/// Writes a mesh, called `title`, in the colours of its distances. As a page (`.html`), it is looked at from everywhere, and the pointer
/// tells the distance.
///
/// # Errors
/// As [`check`]; if the file cannot be written.
pub fn write(path: &Path, title: &str, mesh: &Mesh, reference: &Reference, max_error_m: f64) -> tsdfuse_io::Result<()> {
    if !page::is_page(path) {
        return tsdfuse_io::mesh::write_colored(path, mesh, &by_distance(mesh, reference, max_error_m));
    }
    let distances = reference.distances(&mesh.vertices).into_iter();
    let millimetres: Vec<f32> = distances.map(|distance_m| (1e3 * distance_m) as f32).collect();
    let channel = Channel {
        name: "distance".to_owned(),
        unit: "mm".to_owned(),
        low: 0.0,
        high: (1e3 * max_error_m) as f32,
        ramp: Ramp::Turbo,
        first: true,
    };
    let scene = Scene {
        title: title.to_owned(),
        ..Scene::default()
    };
    let mut mesh = mesh.clone();
    add_normals(&mut mesh);
    let paint = Paint {
        colors: &[],
        channels: &[(channel, &millimetres)],
    };
    page::write(path, &scene, &Surface { mesh: &mesh, paint })?;
    Ok(())
}
