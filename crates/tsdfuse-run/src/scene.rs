//! What a page shows beside a surface: where the sensor was, and figures for people.

use std::path::Path;

use tsdfuse_io::map_file::FusedPose;
use tsdfuse_view::Scene;

use crate::config::RunConfig;
use crate::report::{MapReport, Totals, with_commas};

/// Beside the surface of a run so far, called `title`.
pub(crate) fn of_run(title: &str, config: &RunConfig, totals: &Totals, map: &MapReport, poses: &[FusedPose]) -> Scene {
    let mut scene = of_map(title, config.map.voxel_size_m, map, poses);
    let mut figures = vec![
        ("method".to_owned(), config.method.name().to_owned()),
        ("scans".to_owned(), with_commas(totals.scans as u64)),
        ("points fused".to_owned(), with_commas(totals.sums.fused)),
    ];
    if totals.seconds > 0.0 {
        let rate = totals.scans as f64 / totals.seconds;
        figures.push(("scans a second".to_owned(), format!("{rate:.1}")));
    }
    figures.append(&mut scene.figures);
    Scene { figures, ..scene }
}

/// Beside the surface of a map, called `title`.
pub fn of_map(title: &str, voxel_size_m: f64, map: &MapReport, poses: &[FusedPose]) -> Scene {
    let name = Path::new(title)
        .file_name()
        .map_or(title.into(), |name| name.to_string_lossy());
    let mut figures = vec![
        ("voxels".to_owned(), format!("{voxel_size_m} m")),
        ("voxels observed".to_owned(), with_commas(map.observed_voxels as u64)),
    ];
    if poses.len() > 1 {
        let length_m = tsdfuse::trajectory::length_m(poses.iter().map(|fused| &fused.pose));
        figures.push(("path".to_owned(), format!("{length_m:.1} m")));
    }
    Scene {
        title: name.into_owned(),
        path: poses.iter().map(|fused| fused.pose.translation).collect(),
        figures,
    }
}
