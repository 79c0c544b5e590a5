//! Reading what a mesh is compared with.

use std::path::Path;

use anyhow::{Context, Result, bail};
use glam::DVec3;
use tsdfuse_eval::Reference;
use tsdfuse_io::OpenOptions;
use tsdfuse_io::geometry::{self, Geometry};

use crate::config::{Layers, Suggested};
use crate::progress::{self, note};

/// Reads a cloud, a mesh, or each `every`-th scan of a data set (thesis 7.1.3): all points of its usual ranges, in the
/// world.
pub(crate) fn read_reference(path: &Path, every: usize, options: &OpenOptions) -> Result<Reference> {
    let reference = match path.is_dir() {
        true => Reference::cloud(all_points(path, every, options)?),
        false => match geometry::read(path)? {
            Geometry::Mesh(mesh) => Reference::mesh(mesh),
            Geometry::Cloud(points) => Reference::cloud(points),
        },
    };
    reference.with_context(|| path.display().to_string())
}

/// Reads a cloud, or the vertices of a mesh.
pub(crate) fn read_points(path: &Path) -> Result<Vec<DVec3>> {
    Ok(match geometry::read(path)? {
        Geometry::Mesh(mesh) => mesh.vertices,
        Geometry::Cloud(points) => points,
    })
}

fn all_points(path: &Path, every: usize, options: &OpenOptions) -> Result<Vec<DVec3>> {
    let dataset = tsdfuse_io::open_with(path, options)?;
    dataset.notes().iter().for_each(note);
    let range = Layers::default().resolve(&Suggested::by(&dataset))?.range;
    let bar = progress::scans("reading the reference", dataset.len().div_ceil(every));
    let mut points = Vec::new();
    for read in dataset.iter_range(0..dataset.len(), every) {
        let mut scan = read.scan?;
        scan.drop_invalid(&range);
        points.extend(scan.points_in_world());
        bar.inc(1);
    }
    if points.is_empty() {
        bail!("{}: its scans have no valid points", path.display());
    }
    Ok(points)
}
