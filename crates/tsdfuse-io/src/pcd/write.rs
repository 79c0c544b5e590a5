//! Writing a scan as PCD, `binary`.

use std::path::Path;

use tsdfuse::Scan;

use crate::error::{Error, Result};

/// Writes the points of a scan with what it knows of them: `x y z`, `intensity`, `ring` and `time` (seconds after its pose).
pub(crate) fn write(path: &Path, scan: &Scan) -> Result<()> {
    let columns = [
        ("x", "4 F", true),
        ("y", "4 F", true),
        ("z", "4 F", true),
        ("intensity", "4 F", scan.intensities.is_some()),
        ("time", "4 F", scan.times.is_some()),
        ("ring", "2 U", scan.rings.is_some()),
    ];
    let there = || columns.iter().filter(|(.., is_there)| *is_there);
    let row = |of: fn(&(&str, &str, bool)) -> String| there().map(of).collect::<Vec<_>>().join(" ");
    let part =
        |at: usize| move |&(_, kind, _): &(&str, &str, bool)| kind.split(' ').nth(at).unwrap_or_default().to_owned();
    let kinds = |at: usize| there().map(part(at)).collect::<Vec<_>>().join(" ");
    let count = scan.points.len();
    let mut bytes = format!(
        "VERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n",
        row(|(name, ..)| (*name).to_owned()),
        kinds(0),
        kinds(1),
        row(|_| "1".to_owned()),
    )
    .into_bytes();
    for (i, point) in scan.points.iter().enumerate() {
        bytes.extend(point.to_array().into_iter().flat_map(f32::to_le_bytes));
        for column in [&scan.intensities, &scan.times] {
            bytes.extend(
                column
                    .iter()
                    .filter_map(|values| values.get(i))
                    .flat_map(|v| v.to_le_bytes()),
            );
        }
        bytes.extend(
            scan.rings
                .iter()
                .filter_map(|rings| rings.get(i))
                .flat_map(|v| v.to_le_bytes()),
        );
    }
    std::fs::write(path, bytes).map_err(Error::io(path))
}
