//! The tables of an evaluation.

use crate::results::Results;
use crate::table::Better::{Less, More, Neither};
use crate::table::{Column, Table, column};

/// Distances (thesis 7.1 to 7.4).
const DISTANCE: [Column; 8] = [
    column("average mm", Less, 2, |r| {
        Some(1e3 * r.surface.all.mesh_to_reference.stats.mean_m)
    }),
    column("± std mm", Less, 1, |r| {
        Some(1e3 * r.surface.all.mesh_to_reference.stats.std_m)
    }),
    column("RMSE mm", Less, 1, |r| {
        Some(1e3 * r.surface.all.mesh_to_reference.stats.rmse_m)
    }),
    column("median mm", Less, 2, |r| {
        Some(1e3 * r.surface.all.mesh_to_reference.stats.median_m)
    }),
    column("p95 mm", Less, 1, |r| {
        Some(1e3 * r.surface.all.mesh_to_reference.stats.p95_m)
    }),
    column("Hausdorff m", Less, 3, |r| {
        Some(r.surface.all.mesh_to_reference.stats.max_m)
    }),
    column("back: average mm", Less, 2, |r| {
        Some(1e3 * r.surface.all.reference_to_mesh.stats.mean_m)
    }),
    column("back: Hausdorff m", Less, 3, |r| {
        Some(r.surface.all.reference_to_mesh.stats.max_m)
    }),
];

const DENSE: [Column; 6] = [
    column("average mm", Less, 2, |r| {
        Some(1e3 * r.surface.dense.as_ref()?.measures.mesh_to_reference.stats.mean_m)
    }),
    column("± std mm", Less, 1, |r| {
        Some(1e3 * r.surface.dense.as_ref()?.measures.mesh_to_reference.stats.std_m)
    }),
    column("Hausdorff m", Less, 3, |r| {
        Some(r.surface.dense.as_ref()?.measures.mesh_to_reference.stats.max_m)
    }),
    column("complete", More, 4, |r| {
        Some(r.surface.dense.as_ref()?.measures.thresholds.first()?.completeness)
    }),
    column("F", More, 4, |r| {
        Some(r.surface.dense.as_ref()?.measures.thresholds.first()?.f_score)
    }),
    column("fraction of the mesh", Neither, 3, |r| {
        Some(r.surface.dense.as_ref()?.share_of_mesh)
    }),
];

const SHARES: [Column; 6] = [
    column("precision", More, 4, |r| {
        Some(r.surface.all.thresholds.first()?.precision)
    }),
    column("complete", More, 4, |r| {
        Some(r.surface.all.thresholds.first()?.completeness)
    }),
    column("F", More, 4, |r| Some(r.surface.all.thresholds.first()?.f_score)),
    column("precision ", More, 4, |r| {
        Some(r.surface.all.thresholds.get(1)?.precision)
    }),
    column("complete ", More, 4, |r| {
        Some(r.surface.all.thresholds.get(1)?.completeness)
    }),
    column("F ", More, 4, |r| Some(r.surface.all.thresholds.get(1)?.f_score)),
];

const HELD_OUT: [Column; 8] = [
    column("hits", More, 4, |r| Some(r.held_out.as_ref()?.hit_rate)),
    column("false surface", Less, 4, |r| Some(r.held_out.as_ref()?.false_surface)),
    column("missing", Less, 4, |r| Some(r.held_out.as_ref()?.missing)),
    column("median mm", Less, 1, |r| {
        Some(1e3 * r.held_out.as_ref()?.error?.median_m)
    }),
    column("mean mm", Less, 1, |r| Some(1e3 * r.held_out.as_ref()?.error?.mean_m)),
    column("p95 mm", Less, 1, |r| Some(1e3 * r.held_out.as_ref()?.error?.p95_m)),
    column("bias mm", Neither, 1, |r| Some(1e3 * r.held_out.as_ref()?.bias_m)),
    column("capped mm", Less, 1, |r| {
        Some(1e3 * r.held_out.as_ref()?.capped_error_m)
    }),
];

const SPEED: [Column; 10] = [
    column("scans/s", More, 1, |r| Some(r.speed.scans_per_sec)),
    column("read ms", Less, 1, |r| Some(1e3 * r.speed.read_secs)),
    column("prepare ms", Less, 1, |r| Some(1e3 * r.speed.prepare_secs)),
    column("fuse ms", Less, 1, |r| Some(1e3 * r.speed.fuse_secs)),
    column("mesh s", Less, 2, |r| Some(r.mesh_secs)),
    column("peak MB", Less, 0, |r| Some(1e-6 * r.peak_memory_bytes? as f64)),
    column("map MB", Less, 0, |r| Some(1e-6 * r.map_bytes as f64)),
    column("blocks", Neither, 0, |r| Some(r.map_blocks as f64)),
    column("triangles", Neither, 0, |r| Some(r.triangles as f64)),
    column("fused", More, 4, |r| Some(r.fused_share)),
];

/// All tables that there is something for.
pub fn of(results: &Results) -> Vec<Table> {
    let (reference, rows) = (&results.reference, &results.methods);
    let protocol = &reference.protocol;
    let mut tables = vec![Table::new(
        "Distance to the reference",
        format!(
            "Mesh of all {} scans → {}; protocol {}, {} samples. Hausdorff: the largest distance, one-sided. Back: from the \
             reference points to the mesh.",
            results.dataset.scans, reference.words, protocol.name, protocol.samples
        ),
        &DISTANCE,
        rows,
    )];
    if rows.iter().any(|row| row.surface.dense.is_some()) {
        tables.push(Table::new(
            "Where the reference is dense",
            format!(
                "The same, only where 3 × 3 × 3 cubes of {} m hold {} reference points or more.",
                protocol.dense.cube_m, protocol.dense.points
            ),
            &DENSE,
            rows,
        ));
    }
    let within: Vec<_> = protocol
        .thresholds_m
        .iter()
        .map(|t| format!("{} cm", 100.0 * t))
        .collect();
    tables.push(Table::new(
        "Completeness",
        format!(
            "Fractions within {}: precision of the mesh samples, completeness of the reference points, F their harmonic mean.",
            within.join(", then within ")
        ),
        &SHARES[..(3 * within.len()).min(SHARES.len())],
        rows,
    ));
    if let (Some(every), Some(first)) = (
        results.dataset.hold_out,
        rows.iter().find_map(|row| row.held_out.as_ref()),
    ) {
        tables.push(Table::new(
            "Held-out scans",
            format!(
                "Map without one of every {every} scans; the {} returns of those {} scans are compared along their own rays. Hit: \
                 surface within {} m of the return; false surface: nearer; missing: none up to that range. Errors are |Δr| of the \
                 hits; capped: mean over all returns, where false and missing surface count as {} m.",
                first.returns, results.dataset.held_out_scans, first.margin_m, first.margin_m
            ),
            &HELD_OUT,
            rows,
        ));
    }
    let runs = rows.iter().map(|row| row.scans_per_sec.len()).max().unwrap_or(0);
    let machine = &results.machine;
    let mut speed = Table::new(
        "Speed and memory",
        format!(
            "{}, {} threads, {}. Scans/s: 1 / median of prepare + fuse, with reading in the background; {}. Peak: the whole \
             process, including its mesh. Fused: fraction of the valid returns.",
            machine.processor.as_deref().unwrap_or(&machine.system),
            machine.threads,
            machine.date,
            match runs {
                1 => "1 run".to_owned(),
                _ => format!("median (and range) of {runs} runs, methods taking turns"),
            },
        ),
        &SPEED,
        rows,
    );
    for (number, row) in rows.iter().enumerate().filter(|(_, row)| row.scans_per_sec.len() > 1) {
        let [least, most] =
            [f64::min, f64::max].map(|of| row.scans_per_sec.iter().copied().reduce(of).unwrap_or(f64::NAN));
        speed.append(number, &format!(" ({least:.1}–{most:.1})"));
    }
    tables.push(speed);
    tables
}
