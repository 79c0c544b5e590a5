//! Trajectories: the figures of two as text; plots of one, or of two with the error over the distance, and of the loops that were closed.

use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

use plotters::prelude::*;
use tsdfuse::Pose;
use tsdfuse::render::Image;
use tsdfuse_eval::trajectory::{Compared, Drift, Spread, TrajectoryComparison};
use tsdfuse_io::{atomic, g2o, png};
use tsdfuse_run::report::with_commas;

use crate::error::Result;
use crate::plots::{Chart, axes, said};
use crate::raster::{Canvas, Raster};

/// Width and height of the plot, and how much of the height is the view from above.
const SIZE: (u32, u32) = (720, 860);
const ABOVE: i32 = 600;
/// Around the view from above: left of it and below it are labels.
const MARGINS: (u32, u32) = (76, 56);

/// After Okabe and Ito, "Color Universal Design", 2008.
const TRUTH: RGBColor = BLACK;
const TRACK: RGBColor = RGBColor(213, 94, 0);
const TURN: RGBColor = RGBColor(0, 114, 178);
const CLOSURE: RGBColor = RGBColor(0, 158, 115);

/// All figures of a trajectory against a reference.
pub fn figures(track: &Path, reference: &Path, found: &TrajectoryComparison) -> String {
    let mut text = String::new();
    let seconds = found.seconds.map_or(String::new(), |secs| format!(" in {secs:.1} s"));
    let left_out = match found.left_out {
        0 => String::new(),
        n => format!("; {} without a counterpart", with_commas(n as u64)),
    };
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "{}\nagainst {}: {} poses, {:.1} m{seconds}{left_out}\n",
        track.display(),
        reference.display(),
        with_commas(found.poses as u64),
        found.distance_m,
    );
    let _ = writeln!(
        text,
        "{:18}{:>10}{:>10}{:>10}{:>10}",
        if found.alignment.is_some() {
            "after alignment"
        } else {
            "as they are"
        },
        "RMSE",
        "mean",
        "median",
        "max"
    );
    for (name, spread) in [
        ("position, m", &found.absolute_m),
        ("orientation, deg", &found.absolute_deg),
    ] {
        let Spread {
            rmse,
            mean,
            median,
            max,
        } = spread;
        let _ = writeln!(text, "{name:18}{rmse:>10.4}{mean:>10.4}{median:>10.4}{max:>10.4}");
    }
    let _ = writeln!(text, "\n{:18}{:>10}{:>10}{:>10}", "drift over", "%", "deg/m", "pieces");
    for drift in &found.drift {
        let [length, ..] = drift.lengths_m.as_slice() else {
            continue;
        };
        line(&mut text, &format!("{length} m"), drift);
    }
    if let Some(drift) = &found.kitti
        && let (Some(first), Some(last)) = (drift.lengths_m.first(), drift.lengths_m.last())
    {
        line(&mut text, &format!("{first} to {last} m (KITTI)"), drift);
    }
    if found.drift.is_empty() && found.kitti.is_none() {
        text += "(the drive is too short)\n";
    }
    let _ = writeln!(
        text,
        "\nlast pose, from the first: off by {:.4} m, {:.4} deg",
        found.last_m, found.last_deg
    );
    text
}

fn line(text: &mut String, name: &str, drift: &Drift) {
    let (percent, turn, pieces) = (drift.translation_percent, drift.rotation_deg_per_m, drift.pieces);
    let _ = writeln!(
        text,
        "{name:20}{percent:>8.3}{turn:>10.5}{:>10}",
        with_commas(pieces as u64)
    );
}

/// A point from above, metres.
type Point = (f64, f64);

fn point(pose: &Pose) -> Point {
    (pose.translation.x, pose.translation.y)
}

/// Trajectories from above, and below that the error over the distance, if there is one.
pub struct Plot<'a> {
    lines: Vec<(&'static str, RGBColor, Vec<Point>)>,
    closures: Vec<[Point; 2]>,
    errors: &'a [Compared],
}

impl<'a> Plot<'a> {
    /// Of a trajectory.
    pub fn of(poses: &[Pose]) -> Self {
        Self {
            lines: vec![("trajectory", TRACK, poses.iter().map(point).collect())],
            closures: Vec::new(),
            errors: &[],
        }
    }

    /// Of two.
    pub fn of_both(found: &'a TrajectoryComparison) -> Self {
        let places = |of: fn(&Compared) -> &Pose| found.pairs.iter().map(|pair| point(of(pair))).collect();
        Self {
            lines: vec![
                ("reference", TRUTH, places(|pair| &pair.reference)),
                ("trajectory", TRACK, places(|pair| &pair.aligned)),
            ],
            closures: Vec::new(),
            errors: &found.pairs,
        }
    }

    /// Also the closures of a pose graph, whose world is moved (`drawn_from_graph`): measurements between nodes of which one does not follow the other.
    #[must_use]
    pub fn with_closures(mut self, graph: &g2o::Graph, drawn_from_graph: &Pose) -> Self {
        let moved = |pose: &Pose| point(&(*drawn_from_graph * *pose));
        self.closures = graph.closures().map(|ends| ends.map(|pose| moved(&pose))).collect();
        self
    }

    /// Writes it as `.png`, or else as SVG.
    ///
    /// # Errors
    /// If it cannot be drawn, or the file not be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        if path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
        {
            png::write(path, &self.picture()?)?;
        } else {
            let svg = self.svg()?;
            atomic::write(path, |out| std::io::Write::write_all(out, svg.as_bytes()))?;
        }
        Ok(())
    }

    fn svg(&self) -> Result<String> {
        let mut svg = String::new();
        self.draw(SVGBackend::with_string(&mut svg, self.size()))?;
        Ok(svg)
    }

    fn picture(&self) -> Result<Image> {
        let mut canvas = Canvas::new(self.size());
        self.draw(Raster(&mut canvas))?;
        Ok(canvas.into_image())
    }

    fn size(&self) -> (u32, u32) {
        let (width, height) = SIZE;
        (width, if self.errors.is_empty() { ABOVE as u32 } else { height })
    }

    fn draw<B: DrawingBackend>(&self, backend: B) -> Result<()> {
        let area = backend.into_drawing_area();
        area.fill(&WHITE).map_err(said)?;
        if self.errors.is_empty() {
            self.draw_above(&area)?;
        } else {
            let (above, below) = area.split_vertically(ABOVE);
            self.draw_above(&above)?;
            over_distance(&below, self.errors)?;
        }
        area.present().map_err(said)
    }

    fn draw_above<B: DrawingBackend>(&self, area: &Area<B>) -> Result<()> {
        let all = || self.lines.iter().flat_map(|(.., points)| points);
        let pixels = (f64::from(SIZE.0 - MARGINS.0), f64::from(ABOVE) - f64::from(MARGINS.1));
        let [x, y] = equal_scales(&[span(all().map(|p| p.0)), span(all().map(|p| p.1))], pixels);
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(x, y)
            .map_err(said)?;
        axes(&mut chart, "x, m", "y, m")?;
        for (name, color, points) in &self.lines {
            series(&mut chart, name, *color, points.clone())?;
        }
        if !self.closures.is_empty() {
            let dots = self
                .closures
                .iter()
                .flatten()
                .map(|&at| Circle::new(at, 3, CLOSURE.filled()));
            chart.draw_series(dots).map_err(said)?;
            let ends = self
                .closures
                .iter()
                .map(|ends| PathElement::new(ends.to_vec(), CLOSURE.stroke_width(2)));
            let drawn = chart.draw_series(ends).map_err(said)?;
            let key = |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], CLOSURE.stroke_width(2));
            drawn.label("closures").legend(key);
        }
        legend(&mut chart)
    }
}

type Area<B> = DrawingArea<B, plotters::coord::Shift>;

fn over_distance<B: DrawingBackend>(area: &Area<B>, pairs: &[Compared]) -> Result<()> {
    let lines = [
        ("m", TRACK, (|pair| pair.error_m) as fn(&Compared) -> f64),
        ("deg", TURN, |pair| pair.error_deg),
    ];
    let far = pairs.last().map_or(0.0, |pair| pair.distance_m).max(1e-9);
    let most = pairs
        .iter()
        .flat_map(|pair| [pair.error_m, pair.error_deg])
        .fold(1e-9, f64::max);
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..far, 0.0..1.05 * most)
        .map_err(said)?;
    axes(&mut chart, "distance, m", "error")?;
    for (name, color, error) in lines {
        let points = pairs.iter().map(|pair| (pair.distance_m, error(pair))).collect();
        series(&mut chart, name, color, points)?;
    }
    legend(&mut chart)
}

fn series<B: DrawingBackend>(
    chart: &mut Chart<'_, B>,
    name: &str,
    color: RGBColor,
    points: Vec<(f64, f64)>,
) -> Result<()> {
    let drawn = chart.draw_series(LineSeries::new(points, color.stroke_width(2)));
    let key = move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], color.stroke_width(2));
    drawn.map_err(said)?.label(name).legend(key);
    Ok(())
}

fn legend<'a, B: DrawingBackend + 'a>(chart: &mut Chart<'a, B>) -> Result<()> {
    let mut labels = chart.configure_series_labels();
    labels
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", 13));
    labels.draw().map_err(said)
}

fn span(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    if low <= high { low..high } else { 0.0..0.0 }
}

/// Both ranges, wide enough that a metre is as long on both axes, with a margin.
fn equal_scales(ranges: &[Range<f64>; 2], (width, height): (f64, f64)) -> [Range<f64>; 2] {
    let size = |range: &Range<f64>| range.end - range.start;
    let metres_a_pixel = (size(&ranges[0]) / width).max(size(&ranges[1]) / height).max(1e-6) * 1.05;
    let wide = |range: &Range<f64>, pixels: f64| {
        let (middle, half) = (0.5 * (range.start + range.end), 0.5 * metres_a_pixel * pixels);
        middle - half..middle + half
    };
    [wide(&ranges[0], width), wide(&ranges[1], height)]
}

#[cfg(test)]
mod tests {
    use tsdfuse::Pose;
    use tsdfuse::glam::DVec3;
    use tsdfuse::render::Pixels;
    use tsdfuse::trajectory::Poses;
    use tsdfuse_eval::trajectory::compare;

    use super::*;

    /// A curve, and the same one per cent longer.
    fn found(poses: i32) -> TrajectoryComparison {
        let curve = |scale: f64| {
            let pose = move |i: i32| Pose {
                translation: DVec3::new(f64::from(i), 20.0 * (0.05 * f64::from(i)).sin(), 0.0) * scale,
                ..Pose::IDENTITY
            };
            Poses::Listed((0..poses).map(pose).collect())
        };
        compare(&curve(1.01), &curve(1.0), true).unwrap()
    }

    #[test]
    fn the_text_tells_all_figures() {
        let text = figures(Path::new("a.tum"), Path::new("b.tum"), &found(150));
        for part in [
            "a.tum\nagainst b.tum: 150 poses, ",
            "after alignment",
            "position, m",
            "10 m ",
            "50 m ",
            "100 to 100 m (KITTI)",
            "last pose, from the first: off by ",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(figures(Path::new("a"), Path::new("b"), &found(3)).contains("too short"));
    }

    #[test]
    fn both_trajectories_are_drawn() {
        let both = found(150);
        let svg = Plot::of_both(&both).svg().unwrap();
        assert!(svg.matches("<polyline").count() >= 4);
        for name in ["reference", "trajectory", "distance, m", "deg"] {
            assert!(svg.contains(name), "{name}");
        }
        // Standing still is no reason to fail.
        let one = found(1);
        let plot = Plot::of_both(&one);
        assert!(plot.svg().is_ok() && plot.picture().is_ok());
    }

    #[test]
    fn a_picture_shows_both_trajectories_and_text() {
        let Image { width, height, pixels } = Plot::of_both(&found(150)).picture().unwrap();
        let Pixels::Rgb(pixels) = pixels else {
            panic!("{pixels:?}")
        };
        assert_eq!((width, height, pixels.len()), (1440, 1720, 1440 * 1720));
        let count = |RGBColor(r, g, b)| pixels.iter().filter(|pixel| **pixel == [r, g, b]).count();
        // The two lines are 1 % apart at their ends.
        assert!(count(TRACK) > 2000 && count(TURN) > 500 && count(BLACK) > 2000);
        // The numbers of the axis stand left of it.
        let is_dark = |(at, pixel): (usize, &[u8; 3])| at % width < 130 && at / width < 1000 && pixel[0] < 128;
        assert!(pixels.iter().enumerate().filter(|&pixel| is_dark(pixel)).count() > 500);
    }

    #[test]
    fn closures_are_drawn_where_their_nodes_are() {
        let poses: Vec<Pose> = found(150).pairs.iter().map(|pair| pair.reference).collect();
        let edge = |from, to| g2o::Edge {
            from,
            to,
            measured: Pose::IDENTITY,
            information: [0.0; 21],
        };
        let graph = g2o::Graph {
            nodes: [0, 50, 149].map(|id| (id, poses[id as usize])).to_vec(),
            edges: vec![edge(0, 50), edge(50, 149), edge(0, 149)],
        };
        let plot = Plot::of(&poses).with_closures(&graph, &Pose::IDENTITY);
        assert_eq!(plot.closures, [[point(&poses[0]), point(&poses[149])]]);
        let svg = plot.svg().unwrap();
        assert!(svg.contains("closures") && svg.matches("<circle").count() == 2, "{svg}");
        assert!(!Plot::of(&poses).svg().unwrap().contains("closures"));
    }

    #[test]
    fn a_metre_is_as_long_on_both_axes() {
        let [x, y] = equal_scales(&[0.0..100.0, 5.0..6.0], (500.0, 400.0));
        assert!(((x.end - x.start) / 500.0 - (y.end - y.start) / 400.0).abs() < 1e-12);
        assert!(x.start < 0.0 && x.end > 100.0 && y.start < 5.0 && y.end > 6.0);
    }
}
