//! A folder of point clouds, one `.pcd`, `.ply`, `.bin`, `.las` or `.laz` a scan.
//!
//! The clouds lie in the folder itself or in one folder within it. Poses lie beside the clouds or a folder above; without
//! a pose file, the `VIEWPOINT` of PCD files is the scan's pose. See [`folder`] for optional side files.

use std::path::{Path, PathBuf};

use tsdfuse::Pose;

use crate::error::{Error, Result};
use crate::files::{self, ScanFile};
use crate::folder::{self, PoseFile, ScanFolder};
use crate::pcd;
use crate::poses::{self, Poses};
use crate::source::OpenOptions;

const FORMATS: [(&str, &str); 5] = [
    ("pcd", "PCD folder"),
    ("ply", "PLY folder"),
    ("bin", "KITTI point files"),
    ("las", "LAS folder"),
    ("laz", "LAZ folder"),
];

/// Whether there are clouds in the folder, or in one within it.
pub(crate) fn recognises(path: &Path) -> bool {
    // What is ambiguous is recognised as well: opening it says why.
    !matches!(find(path), Ok(None))
}

pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<ScanFolder> {
    let Clouds { format, folder, files } = find(path)?.ok_or_else(|| Error::dataset(path, "holds no point clouds"))?;
    let root = if folder == path && poses::find(path)?.is_none() && options.poses.is_none() {
        // Opened as `log/clouds` where the poses are `log/poses.txt`.
        let above = path.join("..");
        if poses::find(&above)?.is_some() { above } else { folder }
    } else {
        path.to_owned()
    };
    let is_pcd = format == FORMATS[0].1;
    if is_pcd && options.poses.is_none() && poses::find(&root)?.is_none() {
        let viewpoints = files
            .iter()
            .map(|file| viewpoint(&file.path))
            .collect::<Result<Vec<_>>>()?;
        let any = viewpoints.iter().any(Option::is_some);
        let poses = viewpoints.into_iter().map(Option::unwrap_or_default).collect();
        let poses = any.then(|| PoseFile {
            path: root.clone(),
            poses: Poses::Listed(poses),
            note: None,
        });
        return ScanFolder::new(format, &root, &files, poses, options);
    }
    let poses = folder::poses(&root, options, Path::new(""))?;
    let mut scans = ScanFolder::new(format, &root, &files, poses, options)?;
    if let (true, Some(first)) = (is_pcd, files.first())
        && viewpoint(&first.path)?.is_some()
    {
        scans.note(format!(
            "the VIEWPOINT of {} (and of the other scans) is not used: the pose file is",
            first.name
        ));
    }
    Ok(scans)
}

/// The clouds of a data set.
struct Clouds {
    format: &'static str,
    folder: PathBuf,
    files: Vec<ScanFile>,
}

fn find(path: &Path) -> Result<Option<Clouds>> {
    if let Some(here) = clouds_in(path)? {
        return Ok(Some(here));
    }
    let mut found: Vec<Clouds> = Vec::new();
    for name in files::names(path)? {
        found.extend(clouds_in(&path.join(name))?);
    }
    if let [a, b, ..] = found.as_slice() {
        let reason = format!(
            "holds scans in {} and in {}: open one of them",
            a.folder.display(),
            b.folder.display()
        );
        return Err(Error::dataset(path, reason));
    }
    Ok(found.pop())
}

/// The clouds that lie in the folder itself.
fn clouds_in(folder: &Path) -> Result<Option<Clouds>> {
    for (extension, format) in FORMATS {
        let files = files::list(folder, extension)?;
        // A single PLY without poses is a mesh, or a reference cloud beside the scans' folder.
        let no_scan = extension == "ply" && files.len() == 1 && poses::find(folder)?.is_none();
        if !files.is_empty() && !no_scan {
            return Ok(Some(Clouds {
                format,
                folder: folder.to_owned(),
                files,
            }));
        }
    }
    Ok(None)
}

/// The `VIEWPOINT` in the header of a PCD file.
fn viewpoint(path: &Path) -> Result<Option<Pose>> {
    use std::io::Read;
    let mut start = Vec::new();
    let file = std::fs::File::open(path).map_err(Error::io(path))?;
    file.take(1 << 16).read_to_end(&mut start).map_err(Error::io(path))?;
    Ok(pcd::Header::parse(path, &start)?.viewpoint)
}

#[cfg(test)]
mod tests;
