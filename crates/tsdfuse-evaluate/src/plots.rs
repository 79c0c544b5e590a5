//! Plots as SVG, in colours for light and dark paper.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use tsdfuse_eval::stats::Histogram;

use crate::error::{Error, Result};
use crate::results::{Results, Row};
use crate::style::{Style, TEXT};

/// Width and height of a plot.
const SIZE: (u32, u32) = (720, 340);

/// The share of the highest histogram bins, or of the slowest scans, that a plot need not show.
const HEADROOM: f64 = 1.05;

/// A plot.
#[derive(Clone, Debug)]
pub struct Plot {
    /// What it shows.
    pub title: &'static str,
    /// The plot.
    pub svg: String,
}

/// A line of a plot.
struct Line {
    style: Style,
    points: Vec<(f64, f64)>,
}

/// All plots that there is something for.
///
/// # Errors
/// If one cannot be drawn.
pub fn of(results: &Results) -> Result<Vec<Plot>> {
    let rows = &results.methods;
    let styles = Style::of(rows);
    let surface = |row: &Row| Some(row.surface.all.mesh_to_reference.histogram.clone());
    let held_out = |row: &Row| row.held_out_histogram.clone();
    let mut plots = Vec::new();
    for (of, density, cumulative) in [
        (
            &surface as &dyn Fn(&Row) -> Option<Histogram>,
            "Distances of the mesh to the reference",
            "Share of the mesh within a distance",
        ),
        (
            &held_out,
            "Errors of held-out ranges",
            "Share of the hits within an error",
        ),
    ] {
        let lines = |points: fn(&Histogram) -> Vec<(f64, f64)>| -> Vec<Line> {
            let line = |(row, &style): (&Row, &Style)| {
                let points = points(&of(row)?);
                Some(Line { style, points })
            };
            rows.iter().zip(&styles).filter_map(line).collect()
        };
        if lines(shares).is_empty() {
            continue;
        }
        plots.push(Plot {
            title: density,
            svg: draw(&lines(shares), 100.0, "mm", "% of samples a mm")?,
        });
        plots.push(Plot {
            title: cumulative,
            svg: draw(&lines(sums), 200.0, "mm", "%")?,
        });
    }
    let times = |(row, &style): (&Row, &Style)| {
        let numbered = (0..).zip(&row.scan_secs);
        let points = numbered.map(|(i, secs): (u32, _)| (f64::from(i), 1e3 * secs)).collect();
        Line { style, points }
    };
    let times: Vec<Line> = rows.iter().zip(&styles).map(times).collect();
    let scans = rows.iter().map(|row| row.scan_secs.len()).max().unwrap_or(0);
    plots.push(Plot {
        title: "Time of each scan, prepare + fuse",
        svg: draw(&times, scans.max(2) as f64 - 1.0, "scan", "ms")?,
    });
    plots.push(Plot {
        title: "Memory: map, and peak of the process",
        svg: bars(rows, &styles)?,
    });
    Ok(plots)
}

/// Percent of all distances per millimetre, over millimetres.
fn shares(histogram: &Histogram) -> Vec<(f64, f64)> {
    let total = (histogram.counts.iter().sum::<u64>() + histogram.beyond).max(1) as f64;
    let width_mm = 1e3 * histogram.bin_m;
    let middle = |(i, &count): (u32, &u64)| ((f64::from(i) + 0.5) * width_mm, 100.0 * count as f64 / total / width_mm);
    (0..).zip(&histogram.counts).map(middle).collect()
}

/// Percent of all distances up to so many millimetres.
fn sums(histogram: &Histogram) -> Vec<(f64, f64)> {
    let sums = histogram.cumulative();
    let end = |(i, share): (u32, f64)| (f64::from(i) * 1e3 * histogram.bin_m, 100.0 * share);
    std::iter::once((0.0, 0.0)).chain((1..).zip(sums).map(end)).collect()
}

/// A plot with numbers on both axes.
pub(crate) type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Grid, names and numbers of both axes.
pub(crate) fn axes<B: DrawingBackend>(chart: &mut Chart<'_, B>, x: &str, y: &str) -> Result<()> {
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(x)
        .y_desc(y)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.15));
    mesh.x_label_formatter(&brief)
        .y_label_formatter(&brief)
        .label_style(("sans-serif", 13))
        .draw()
        .map_err(said)
}

/// Lines over 0 … `x_max`, less where they all end earlier.
fn draw(lines: &[Line], x_max: f64, x_label: &str, y_label: &str) -> Result<String> {
    let points = || lines.iter().flat_map(|line| &line.points);
    let x_max = points().map(|p| p.0).fold(0.0, f64::max).min(x_max).max(1e-9);
    let y_max = points()
        .filter(|p| p.0 <= x_max)
        .map(|p| p.1)
        .fold(0.0, f64::max)
        .max(1e-9);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&area)
            .margin(8)
            .x_label_area_size(40)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..x_max, 0.0..y_max * HEADROOM)
            .map_err(said)?;
        axes(&mut chart, x_label, y_label)?;
        for line in lines {
            let [r, g, b] = line.style.rgb();
            let stroke = RGBColor(r, g, b).stroke_width(2);
            let points = line.points.iter().copied().filter(|p| p.0 <= x_max);
            let drawn = match line.style.dashes {
                Some((dash, gap)) => {
                    let dashed = DashedLineSeries::new(points, dash, gap, stroke);
                    chart.draw_series(dashed).map(drop)
                }
                None => chart.draw_series(LineSeries::new(points, stroke)).map(drop),
            };
            drawn.map_err(said)?;
        }
        area.present().map_err(said)?;
    }
    Ok(for_any_paper(&svg))
}

/// The map's memory over the peak's, for each form.
fn bars(rows: &[Row], styles: &[Style]) -> Result<String> {
    let megabytes =
        |row: &Row| [row.peak_memory_bytes.unwrap_or(row.map_bytes), row.map_bytes].map(|b| 1e-6 * b as f64);
    let most = rows.iter().map(|row| megabytes(row)[0]).fold(1.0, f64::max);
    let count = rows.len() as f64;
    let mut svg = String::new();
    {
        let size = (SIZE.0, 60 + 26 * rows.len() as u32);
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let mut chart = ChartBuilder::on(&area)
            .margin(8)
            .x_label_area_size(40)
            .y_label_area_size(150)
            .build_cartesian_2d(0.0..most * HEADROOM, 0.0..count)
            .map_err(said)?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("MB")
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.15))
            .y_labels(0);
        mesh.x_label_formatter(&brief)
            .label_style(("sans-serif", 13))
            .draw()
            .map_err(said)?;
        for (i, (row, style)) in rows.iter().zip(styles).enumerate() {
            let [r, g, b] = style.rgb();
            let top = count - i as f64;
            for (length, opacity) in megabytes(row).into_iter().zip([0.4, 1.0]) {
                let bar = Rectangle::new(
                    [(0.0, top - 0.8), (length, top - 0.2)],
                    RGBColor(r, g, b).mix(opacity).filled(),
                );
                chart.draw_series([bar]).map_err(said)?;
            }
            let (x, y) = chart.backend_coord(&(0.0, top - 0.5));
            let place = plotters::style::text_anchor::Pos::new(
                plotters::style::text_anchor::HPos::Right,
                plotters::style::text_anchor::VPos::Center,
            );
            let text = TextStyle::from(("sans-serif", 13)).pos(place);
            area.draw(&Text::new(
                row.form.name.chars().take(24).collect::<String>(),
                (x - 6, y),
                text,
            ))
            .map_err(said)?;
        }
        area.present().map_err(said)?;
    }
    Ok(for_any_paper(&svg))
}

/// A number without zeros at its end.
pub(crate) fn brief(value: &f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Axes and text in the colour of the page's text.
fn for_any_paper(svg: &str) -> String {
    svg.replace("\"#000000\"", &format!("\"{TEXT}\""))
}

pub(crate) fn said(error: impl std::fmt::Display) -> Error {
    Error::failed(format_args!("a plot: {error}"))
}
