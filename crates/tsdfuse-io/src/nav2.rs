//! Maps of `nav2` (ROS 2): a picture (`.pgm`) of free and occupied cells from above, and a YAML file that tells where it lies.

use std::io::Write;
use std::path::{Path, PathBuf};

use tsdfuse::glam::DVec2;

use crate::error::{Error, Result};

/// A map from above.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    /// The lower left corner of the first cell, world, metres.
    pub origin: DVec2,
    /// Edge of a cell, metres.
    pub cell_m: f64,
    /// Cells along x.
    pub width: usize,
    /// Row by row along x, from the lowest y on: 0 (free) to 100 (occupied); `None` for unknown cells.
    pub costs: Vec<Option<u8>>,
}

/// Stands for unknown cells.
const UNKNOWN: u8 = 255;

/// Writes the YAML file at `path` (`.yaml` or `.yml`), and the picture beside it, with the extension `.pgm`, which is returned. The
/// picture's values are those of the costs (`mode: raw`), so none is rounded.
///
/// # Errors
/// Names the file and what the system says; also for another extension, or a name that YAML cannot hold in one line.
pub fn write(path: impl AsRef<Path>, grid: &OccupancyGrid) -> Result<PathBuf> {
    let path = path.as_ref();
    let picture = picture_beside(path)?;
    let name = picture.file_name().unwrap_or_default().to_string_lossy();
    let rows = grid.costs.chunks_exact(grid.width.max(1)).rev();
    crate::atomic::write(&picture, |out| {
        write!(out, "P5\n{} {}\n255\n", grid.width, rows.len())?;
        // From the highest y on.
        let mut bytes = rows.clone().flatten().map(|cost| cost.unwrap_or(UNKNOWN));
        bytes.try_for_each(|byte| out.write_all(&[byte]))
    })?;
    // To a nanometre: sums of cells end in digits that mean nothing.
    let [x, y] = grid.origin.to_array().map(|at| (at * 1e9).round() / 1e9);
    crate::atomic::write(path, |out| {
        write!(
            out,
            "image: \"{name}\"\nmode: raw\nresolution: {}\norigin: [{x}, {y}, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n",
            grid.cell_m
        )
    })?;
    Ok(picture)
}

/// The name of the picture that [`write()`] puts beside a YAML file.
///
/// # Errors
/// As [`write()`].
pub fn picture_beside(path: &Path) -> Result<PathBuf> {
    let is_yaml = |extension: &std::ffi::OsStr| extension == "yaml" || extension == "yml";
    if !path.extension().is_some_and(is_yaml) {
        return Err(Error::dataset(path, "a map of nav2 is written as .yaml"));
    }
    let picture = path.with_extension("pgm");
    match picture.file_name().and_then(|name| name.to_str()) {
        Some(name) if !name.contains(['"', '\\', '\n']) => Ok(picture),
        _ => Err(Error::dataset(path, "such a name cannot be told in YAML")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_has_the_highest_y_first() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map.yaml");
        let grid = OccupancyGrid {
            origin: DVec2::new(-1.5, 3.0 * 0.2),
            cell_m: 0.25,
            width: 3,
            costs: vec![Some(0), Some(1), None, Some(100), Some(50), Some(99)],
        };
        let picture = write(&path, &grid).unwrap();
        assert_eq!(
            std::fs::read(picture).unwrap(),
            b"P5\n3 2\n255\n\x64\x32\x63\x00\x01\xff"
        );
        let yaml = std::fs::read_to_string(&path).unwrap();
        assert!(
            yaml.starts_with("image: \"map.pgm\"\nmode: raw\nresolution: 0.25\norigin: [-1.5, 0.6, 0]\n"),
            "{yaml}"
        );
    }

    #[test]
    fn other_names_are_refused() {
        let told = |name: &str| picture_beside(Path::new(name)).unwrap_err().to_string();
        assert!(told("a.png").ends_with("a map of nav2 is written as .yaml"));
        assert!(told("a\".yaml").ends_with("such a name cannot be told in YAML"));
    }
}
