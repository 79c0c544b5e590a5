//! Reading what meshes are compared with.

use std::path::Path;

use tsdfuse::glam::DVec3;
use tsdfuse::scan::RangeLimits;
use tsdfuse_eval::Reference;
use tsdfuse_io::geometry::{self, Geometry};
use tsdfuse_io::{Log, OpenOptions};

use crate::error::{Error, Result};
use crate::progress::{Progress, Watch};

/// Reads a cloud, a mesh, or every `every`-th scan of a log (thesis 7.1.3): all its points within the usual ranges, in the
/// world.
///
/// # Errors
/// If it cannot be read, or has no points.
pub fn read(path: &Path, every: usize, options: &OpenOptions, watch: &mut Watch<'_>) -> Result<Reference> {
    if path.is_dir() {
        let log = tsdfuse_io::open_with(path, options)?;
        log.notes().iter().for_each(|note| watch(Progress::Note(note)));
        let indices = (0..length(&log)?).step_by(every.max(1)).collect();
        let points = points_of(&log, indices, &log.suggested().range, false, watch)?;
        if points.is_empty() {
            return Err(Error::failed(format_args!(
                "{}: its scans have no valid points",
                path.display()
            )));
        }
        return Reference::cloud(points).map_err(Error::at(path));
    }
    let reference = match geometry::read(path)? {
        Geometry::Mesh(mesh) => Reference::mesh(mesh),
        Geometry::Cloud(points) => Reference::cloud(points),
    };
    reference.map_err(Error::at(path))
}

/// Adds to a reference where a sensor saw it: the points of a cloud, or the vertices of a mesh. Completeness is then asked
/// for only there.
///
/// # Errors
/// If the file cannot be read, or has no points.
pub fn observed_at(reference: Reference, path: &Path) -> Result<Reference> {
    let points = match geometry::read(path)? {
        Geometry::Mesh(mesh) => mesh.vertices,
        Geometry::Cloud(points) => points,
    };
    reference.with_observed(points).map_err(Error::at(path))
}

/// The number of scans of a log that can be read again and again.
pub(crate) fn length(log: &Log) -> Result<usize> {
    log.len()
        .ok_or_else(|| Error::config("scans that come as a stream can be read only once: record them in files first"))
}

/// The valid points of these scans, in the world. Scans that cannot be used are left out, if they are to be skipped.
pub(crate) fn points_of(
    log: &Log,
    indices: Vec<usize>,
    range: &RangeLimits,
    skip_bad: bool,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    watch(Progress::Begun {
        work: "reading the reference",
        steps: Some(indices.len()),
    });
    let mut all = Vec::new();
    for read in log.read_indices(indices) {
        watch(Progress::Step);
        let placed = read.scan.map_err(Error::from).and_then(|mut scan| {
            scan.drop_invalid(range);
            all.extend(scan.points_in_world().map_err(Error::failed)?);
            Ok(())
        });
        match placed {
            Err(error) if !skip_bad => return Err(error),
            _ => {}
        }
    }
    watch(Progress::Done);
    Ok(all)
}
