//! The tables: rows are methods, columns are figures; as text, Markdown and HTML.

use super::page::escape;
use super::results::{Results, Row};

/// A table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Table {
    pub(crate) title: String,
    /// What the figures are.
    pub(crate) note: String,
    head: Vec<&'static str>,
    better: Vec<Better>,
    rows: Vec<(String, Vec<Cell>)>,
}

/// Which values of a column are good.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Better {
    Less,
    More,
    Neither,
}

/// A figure and how it is written.
#[derive(Clone, Debug)]
struct Cell {
    value: Option<f64>,
    text: String,
}

/// How a column is made.
struct Column {
    head: &'static str,
    better: Better,
    decimals: usize,
    of: fn(&Row) -> Option<f64>,
}

const fn column(head: &'static str, better: Better, decimals: usize, of: fn(&Row) -> Option<f64>) -> Column {
    Column {
        head,
        better,
        decimals,
        of,
    }
}

use Better::{Less, More, Neither};

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
    column("share of the mesh", Neither, 3, |r| {
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
pub(crate) fn of(results: &Results) -> Vec<Table> {
    let reference = &results.reference;
    let protocol = &reference.protocol;
    let mut tables = vec![Table::new(
        "Distance to the reference",
        format!(
            "Mesh of all {} scans → {}; protocol {}, {} samples. Hausdorff: the largest distance, one-sided. Back: from the \
             reference's points to the mesh.",
            results.dataset.scans, reference.words, protocol.name, protocol.samples
        ),
        &DISTANCE,
        results,
    )];
    if results.methods.iter().any(|row| row.surface.dense.is_some()) {
        tables.push(Table::new(
            "Where the reference is dense",
            format!(
                "The same, only where 3 × 3 × 3 cubes of {} m hold {} reference points or more.",
                protocol.dense.cube_m, protocol.dense.points
            ),
            &DENSE,
            results,
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
            "Shares within {}: precision of the mesh's samples, complete of the reference's points, F their harmonic mean.",
            within.join(", then within ")
        ),
        &SHARES[..(3 * within.len()).min(SHARES.len())],
        results,
    ));
    if let (Some(every), Some(first)) = (
        results.dataset.hold_out,
        results.methods.iter().find_map(|row| row.held_out.as_ref()),
    ) {
        tables.push(Table::new(
            "Held-out scans",
            format!(
                "Map without one of {every} scans; the {} returns of these {} along their own rays. Hit: surface within {} m of \
                 the return; false surface: nearer than that; missing: none up to that. Errors are |Δr| of the hits; capped: the \
                 mean over all returns, where false and missing surface count as {} m.",
                first.returns, results.dataset.held_out_scans, first.margin_m, first.margin_m
            ),
            &HELD_OUT,
            results,
        ));
    }
    let runs = results
        .methods
        .iter()
        .map(|row| row.scans_per_sec.len())
        .max()
        .unwrap_or(0);
    let mut speed = Table::new(
        "Speed and memory",
        format!(
            "{}, {} threads, {}. Scans/s: 1 / median of prepare + fuse, reading in the background; {runs} run{}. Peak: of the whole \
             process with its mesh. Fused: share of the valid returns.",
            results.machine.processor.as_deref().unwrap_or(results.machine.system),
            results.machine.threads,
            results.machine.date,
            if runs == 1 { "" } else { "s" },
        ),
        &SPEED,
        results,
    );
    for (row, (_, cells)) in results.methods.iter().zip(&mut speed.rows) {
        let [least, most] =
            [f64::min, f64::max].map(|of| row.scans_per_sec.iter().copied().reduce(of).unwrap_or(f64::NAN));
        if let Some(cell) = cells.first_mut().filter(|_| row.scans_per_sec.len() > 1) {
            cell.text += &format!(" ({least:.1}–{most:.1})");
        }
    }
    tables.push(speed);
    tables
}

impl Table {
    fn new(title: &str, note: String, columns: &[Column], results: &Results) -> Self {
        let cell = |column: &Column, row: &Row| {
            let value = (column.of)(row).filter(|v| v.is_finite());
            let text = value.map_or("–".to_owned(), |v| format!("{v:.*}", column.decimals));
            Cell { value, text }
        };
        let row = |row: &Row| (row.form.name.clone(), columns.iter().map(|c| cell(c, row)).collect());
        Self {
            title: title.to_owned(),
            note,
            head: columns.iter().map(|c| c.head).collect(),
            better: columns.iter().map(|c| c.better).collect(),
            rows: results.methods.iter().map(row).collect(),
        }
    }

    /// Whether a cell holds the best value of its column, as it is written.
    fn is_best(&self, cells: &[Cell], column: usize) -> bool {
        let values = || self.rows.iter().filter_map(|(_, cells)| cells[column].value);
        let best = match self.better[column] {
            Neither => None,
            Less => values().reduce(f64::min),
            More => values().reduce(f64::max),
        };
        let is_best =
            |(_, other): &(String, Vec<Cell>)| other[column].value == best && other[column].text == cells[column].text;
        best.is_some() && self.rows.len() > 1 && self.rows.iter().any(is_best)
    }

    /// For a terminal.
    pub(crate) fn text(&self) -> String {
        let mut lines = vec![vec![String::new()]];
        lines[0].extend(self.head.iter().map(|h| h.trim().to_owned()));
        for (name, cells) in &self.rows {
            let cells = cells.iter().map(|cell| cell.text.clone());
            lines.push(std::iter::once(name.clone()).chain(cells).collect());
        }
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..=self.head.len()).map(width).collect();
        let mut text = format!("{}\n", self.title);
        for line in &lines {
            let name = format!("  {:<1$}", line[0], widths[0]);
            let figures = line[1..]
                .iter()
                .zip(&widths[1..])
                .map(|(figure, width)| format!("  {figure:>width$}"));
            text += &(name + &figures.collect::<String>());
            text.push('\n');
        }
        text
    }

    /// A Markdown table; the best of each column is bold.
    pub(crate) fn markdown(&self) -> String {
        let mut text = format!("**{}.** {}\n\n| |", self.title, self.note);
        text.extend(self.head.iter().map(|head| format!(" {} |", head.trim())));
        text += "\n|---|";
        text += &"---|".repeat(self.head.len());
        text.push('\n');
        for (name, cells) in &self.rows {
            text += &format!("| `{name}` |");
            for (column, cell) in cells.iter().enumerate() {
                let bold = if self.is_best(cells, column) { "**" } else { "" };
                text += &format!(" {bold}{}{bold} |", cell.text);
            }
            text.push('\n');
        }
        text
    }

    /// An HTML table; the best of each column is bold.
    pub(crate) fn html(&self) -> String {
        let mut html = format!(
            "<h2>{}</h2>\n<p>{}</p>\n<div class=\"wide\"><table><tr><th></th>",
            self.title,
            escape(&self.note)
        );
        html.extend(self.head.iter().map(|head| format!("<th>{}</th>", head.trim())));
        html += "</tr>\n";
        for (name, cells) in &self.rows {
            html += &format!("<tr><th>{}</th>", escape(name));
            for (column, cell) in cells.iter().enumerate() {
                let class = if self.is_best(cells, column) {
                    " class=\"best\""
                } else {
                    ""
                };
                html += &format!("<td{class}>{}</td>", cell.text);
            }
            html += "</tr>\n";
        }
        html + "</table></div>\n"
    }
}
