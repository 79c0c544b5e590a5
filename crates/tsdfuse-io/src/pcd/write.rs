//! Writing a scan as PCD, `binary`.

use std::path::Path;

use tsdfuse::Scan;

use crate::error::{Error, Result};
use crate::point_rows;
use crate::scalar::Scalar;

/// Writes the points of a scan with what it knows of them: `x y z`, `intensity`, `ring` and `time` (seconds after its pose).
pub(crate) fn write(path: &Path, scan: &Scan) -> Result<()> {
    let columns = point_rows::columns(scan);
    let row = |of: fn(&(&str, Scalar)) -> String| columns.iter().map(of).collect::<Vec<_>>().join(" ");
    let count = scan.points.len();
    let mut bytes = format!(
        "VERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n",
        row(|(name, _)| (*name).to_owned()),
        row(|(_, scalar)| scalar.size().to_string()),
        row(|(_, scalar)| if scalar.is_integer() { "U" } else { "F" }.to_owned()),
        row(|_| "1".to_owned()),
    )
    .into_bytes();
    point_rows::append(scan, &mut bytes);
    std::fs::write(path, bytes).map_err(Error::io(path))
}
