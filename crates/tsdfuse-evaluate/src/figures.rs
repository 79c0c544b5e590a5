//! The figures of one mesh, as text.

use std::fmt::Write;
use std::path::Path;

use tsdfuse_eval::Comparison;
use tsdfuse_eval::compare::{Direction, Measures};
use tsdfuse_run::report::with_commas;

/// All figures of a mesh against a reference.
pub fn of(mesh: &Path, reference: &Path, comparison: &Comparison) -> String {
    let Comparison {
        protocol,
        inputs,
        all,
        dense,
        ..
    } = comparison;
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "{} ({} triangles, {:.1} m²)\nagainst {} ({}, {} points), protocol {}\n\nall, mm",
        mesh.display(),
        with_commas(inputs.triangles as u64),
        inputs.area_m2,
        reference.display(),
        inputs.reference,
        with_commas(inputs.reference_points as u64),
        protocol.name,
    );
    measures(&mut text, all);
    if let Some(dense) = dense {
        let _ = writeln!(
            text,
            "\ndensely observed, mm: {:.1} % of the mesh, {:.1} % of the reference\n\
             (3 × 3 × 3 cubes of {} m hold {} reference points or more)",
            100.0 * dense.share_of_mesh,
            100.0 * dense.share_of_reference,
            protocol.dense.cube_m,
            protocol.dense.points,
        );
        measures(&mut text, &dense.measures);
    }
    text
}

fn measures(text: &mut String, measures: &Measures) {
    let _ = writeln!(
        text,
        "{:18}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}",
        "", "mean", "std", "RMSE", "median", "p90", "p95", "p99", "Hausdorff"
    );
    direction(text, "mesh → reference", &measures.mesh_to_reference);
    direction(text, "reference → mesh", &measures.reference_to_mesh);
    let _ = writeln!(text, "{:18}{:>10.2}", "Chamfer L1", 1000.0 * measures.chamfer_l1_m);
    let _ = writeln!(
        text,
        "{:18}{:>10}{:>14}{:>10}",
        "within", "precision", "completeness", "F-score"
    );
    for at in &measures.thresholds {
        let within = format!("{} mm", (1e6 * at.threshold_m).round() / 1e3);
        let (precision, completeness, f_score) = (at.precision, at.completeness, at.f_score);
        let _ = writeln!(text, "{within:18}{precision:>10.4}{completeness:>14.4}{f_score:>10.4}");
    }
}

fn direction(text: &mut String, name: &str, direction: &Direction) {
    let stats = &direction.stats;
    let figures = [
        stats.mean_m,
        stats.std_m,
        stats.rmse_m,
        stats.median_m,
        stats.p90_m,
        stats.p95_m,
        stats.p99_m,
    ];
    let _ = write!(text, "{name:18}");
    for figure in figures {
        let _ = write!(text, "{:>10.2}", 1000.0 * figure);
    }
    let _ = write!(text, "{:>12.2}", 1000.0 * stats.max_m);
    for (count, what) in [(direction.left_out, "left out"), (direction.clamped, "clamped")] {
        if count > 0 {
            let _ = write!(text, "  {} {what}", with_commas(count as u64));
        }
    }
    text.push('\n');
}
