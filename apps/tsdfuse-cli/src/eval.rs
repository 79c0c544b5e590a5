//! `tsdfuse eval`: how good a mesh is.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use serde::Serialize;
use tsdfuse::glam::DVec3;
use tsdfuse_eval::{Comparison, Protocol, compare};
use tsdfuse_evaluate::{colored, figures, reference};
use tsdfuse_io::OpenOptions;
use tsdfuse_run::{check_outputs, peak_memory_bytes};

use crate::exit::{Outcome, Usage};
use crate::measuring::{Bars, told};
use crate::output::{print, print_json};
use crate::progress::{self, note, say};

const EXAMPLES: &str = "\
Examples:
  tsdfuse eval street.ply --reference street
  tsdfuse eval street.ply --reference pandaset/002 --protocol thesis --every 10
  tsdfuse eval street.ply --reference street/scene.ply --observed street/hits.ply
  tsdfuse eval street.ply --reference survey.pcd --crop=-20,-20,-3,20,20,10 --colored errors.glb

What each figure and protocol means is written in docs/evaluation.md.";

/// Compare a mesh with a point cloud, another mesh or all scans of a log.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// The mesh, .ply, .obj or .glb.
    mesh: PathBuf,
    /// The reference: a cloud (.ply, .pcd), a mesh (.ply, .obj, .glb), or a log (all of its points).
    #[arg(long, value_name = "FILE|LOG")]
    reference: PathBuf,
    /// Use only every N-th scan of the log.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// The sensor to use: one of several in the log.
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// Measure completeness only at the points of this cloud: the part of the reference that a sensor saw.
    #[arg(long, value_name = "FILE")]
    observed: Option<PathBuf>,
    /// The rules of measurement.
    #[arg(long, value_name = "NAME", default_value = "surface", value_parser = PossibleValuesParser::new(Protocol::NAMES))]
    protocol: String,
    /// Distance thresholds of precision, completeness and F-score, metres [default: the protocol's].
    #[arg(long, value_name = "M,M", value_delimiter = ',')]
    thresholds: Vec<f64>,
    /// Compare only what lies in this box: two corners, metres.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    crop: Option<Crop>,
    /// Number of samples on the mesh [default: the protocol's].
    #[arg(long, value_name = "N")]
    samples: Option<usize>,
    /// Write the mesh coloured by error (.ply, .glb): dark blue at 0, yellow at --max-error and beyond. As .html, a page that shows it in
    /// any browser; the pointer tells the error.
    #[arg(long, value_name = "FILE")]
    colored: Option<PathBuf>,
    /// The error shown in yellow, metres [default: the largest threshold].
    #[arg(long, value_name = "M", requires = "colored")]
    max_error: Option<f64>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Two corners of a box.
#[derive(Clone, Copy, Debug)]
struct Crop([DVec3; 2]);

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
        match numbers.as_deref() {
            Ok(&[a, b, c, d, e, f]) => {
                let [a, b] = [DVec3::new(a, b, c), DVec3::new(d, e, f)];
                Ok(Self([a.min(b), a.max(b)]))
            }
            _ => Err("expected six numbers, as in -20,-20,-3,20,20,10".to_owned()),
        }
    }
}

/// What was measured, and on what.
#[derive(Debug, Serialize)]
struct Report<'a> {
    /// The program's version.
    version: &'static str,
    mesh: &'a Path,
    reference: &'a Path,
    observed: Option<&'a Path>,
    /// Each so many-th scan of a log was taken.
    every: u32,
    #[serde(flatten)]
    comparison: &'a Comparison,
    colored: Option<Colored<'a>>,
    /// Comparing, without reading.
    seconds: f64,
    /// The most memory that the process held, where the system tells.
    peak_memory_bytes: Option<u64>,
}

/// The coloured mesh.
#[derive(Debug, Serialize)]
struct Colored<'a> {
    path: &'a Path,
    /// The distance of the last colour.
    max_error_m: f64,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let protocol = args.protocol()?;
    let colored = args.colored(&protocol)?;
    let mesh = tsdfuse_io::mesh::read(&args.mesh)?;
    let options = OpenOptions {
        sensors: args.sensor.iter().cloned().collect(),
        ..OpenOptions::default()
    };
    let mut bars = Bars::default();
    let found = reference::read(&args.reference, args.every as usize, &options, &mut |p| bars.show(&p));
    let mut reference = found.map_err(told)?;
    if let Some(path) = &args.observed {
        reference = reference::observed_at(reference, path).map_err(told)?;
    }
    let start = Instant::now();
    let spinner = progress::working("measuring");
    let comparison = compare(&mesh, &reference, &protocol).with_context(|| args.mesh.display().to_string())?;
    let seconds = start.elapsed().as_secs_f64();
    comparison
        .warnings
        .iter()
        .for_each(|warning| say(format_args!("tsdfuse: warning: {warning}")));
    if let Some(Colored { path, max_error_m }) = &colored {
        let title = args.mesh.file_name().unwrap_or_default().to_string_lossy();
        colored::write(path, &title, &mesh, &reference, *max_error_m)?;
    }
    drop(spinner);
    if args.json {
        print_json(&Report {
            version: env!("CARGO_PKG_VERSION"),
            mesh: &args.mesh,
            reference: &args.reference,
            observed: args.observed.as_deref(),
            every: args.every,
            comparison: &comparison,
            colored,
            seconds,
            peak_memory_bytes: peak_memory_bytes(),
        })?;
    } else {
        print(&figures::of(&args.mesh, &args.reference, &comparison))?;
        // A page has a legend of its own.
        if let Some(Colored { path, max_error_m }) = &colored
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html"))
        {
            note(format_args!(
                "{}: dark blue at 0, yellow from {max_error_m} m on",
                path.display()
            ));
        }
    }
    Ok(Outcome::Complete)
}

impl Args {
    fn protocol(&self) -> Result<Protocol> {
        let mut protocol = Protocol::by_name(&self.protocol).unwrap_or_else(Protocol::surface);
        if !self.thresholds.is_empty() {
            protocol.thresholds_m.clone_from(&self.thresholds);
        }
        protocol.samples = self.samples.unwrap_or(protocol.samples);
        protocol.crop = self.crop.map(|crop| crop.0);
        protocol.check().map_err(Usage::new)?;
        Ok(protocol)
    }

    /// Where the coloured mesh is to go, and its scale.
    fn colored(&self, protocol: &Protocol) -> Result<Option<Colored<'_>>> {
        let Some(path) = &self.colored else { return Ok(None) };
        colored::check(path).map_err(Usage::new)?;
        let inputs = [Some(&self.mesh), Some(&self.reference), self.observed.as_ref()];
        let inputs: Vec<&Path> = inputs.into_iter().flatten().map(PathBuf::as_path).collect();
        check_outputs(&inputs, &[path])?;
        let largest = protocol.thresholds_m.iter().copied().fold(0.0, f64::max);
        let max_error_m = self.max_error.unwrap_or(largest);
        if max_error_m > 0.0 && max_error_m.is_finite() {
            return Ok(Some(Colored { path, max_error_m }));
        }
        Err(Usage::new(format_args!("--max-error must be more than 0, not {max_error_m}")).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_a_crop_come_in_any_order() {
        let Crop([low, high]) = "1,-2,3,-1,2,4".parse().unwrap();
        assert_eq!((low, high), (DVec3::new(-1.0, -2.0, 3.0), DVec3::new(1.0, 2.0, 4.0)));
        for bad in ["", "1,2,3", "1,2,3,4,5,x", "1,2,3,4,5,6,7"] {
            assert!(bad.parse::<Crop>().is_err(), "{bad}");
        }
    }
}
