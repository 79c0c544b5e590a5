//! Labels of returns, as SemanticKITTI has them: a file for each scan, four bytes for each return, in the order in which they were
//! measured. 9 stays, 251 moves, 0 was not looked at.

use std::fs;
use std::path::Path;

use tsdfuse::glam::Vec3;
use tsdfuse_io::Error;

use crate::error::Result;

const UNLABELLED: u32 = 0;
const STATIC: u32 = 9;
const MOVING: u32 = 251;

/// Makes the folder.
pub(crate) fn begin(folder: &Path) -> Result<()> {
    Ok(fs::create_dir_all(folder).map_err(Error::io(folder))?)
}

/// Writes the labels of a scan: of all that was measured, those that are not among the `kept` (in order) were not looked at.
pub(crate) fn write(folder: &Path, index: usize, measured: &[Vec3], kept: &[Vec3], is_moving: &[bool]) -> Result<()> {
    let mut bytes = Vec::with_capacity(4 * measured.len());
    let mut known = kept.iter().zip(is_moving).peekable();
    for point in measured {
        // Returns that were dropped are no number, or lie where none is kept.
        let label = match known.next_if(|(kept, _)| *kept == point) {
            Some((_, true)) => MOVING,
            Some((_, false)) => STATIC,
            None => UNLABELLED,
        };
        bytes.extend_from_slice(&label.to_le_bytes());
    }
    let path = folder.join(format!("{index:06}.label"));
    Ok(fs::write(&path, bytes).map_err(Error::io(&path))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_returns_have_no_label() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("a/b");
        begin(&folder).unwrap();
        let at = |x: f32| Vec3::new(x, 1.0, 0.0);
        let measured = [at(1.0), at(f32::NAN), at(2.0), at(0.0), at(3.0), at(99.0)];
        write(
            &folder,
            7,
            &measured,
            &[at(1.0), at(2.0), at(3.0)],
            &[false, true, false],
        )
        .unwrap();
        let bytes = fs::read(folder.join("000007.label")).unwrap();
        let labels: Vec<u32> = bytes
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        assert_eq!(labels, [STATIC, UNLABELLED, MOVING, UNLABELLED, STATIC, UNLABELLED]);
    }
}
