//! `tsdfuse evaluate`: methods side by side on a log, as tables, plots and pictures.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::PossibleValuesParser;
use tsdfuse::MapConfig;
use tsdfuse::glam::DVec3;
use tsdfuse_eval::Protocol;
use tsdfuse_evaluate::{Comparing, Contest, Evaluated, Evaluation, Form, PoseNoise, ScanPoses, Tuned, Tuning, tables};
use tsdfuse_io::DEPTH_CAMERA_TRUNCATION_M;

use crate::args::{LogArgs, parse_triple};
use crate::exit::{Outcome, Usage};
use crate::measuring::{Bars, told};
use crate::output::{command_line, print, print_json, print_results};
use crate::progress::{note, say};
use crate::run_job;

const EXAMPLES: &str = "\
What is compared: a mesh of all scans with the reference; and a map without every K-th scan with the returns of those \
(hits, false surface, missing surface). The reference is --reference, or the true surface of a simulated log, or the \
points of all scans. Each method runs in a process of its own; of several runs, methods take turns and the median speed \
counts. What each figure means: docs/evaluation.md. --poses given,refine,track compares each method with these poses.

Examples:
  tsdfuse evaluate pandaset/002 -o pandaset-002
  tsdfuse evaluate street --methods raycast,raycast-projective --runs 5 -o street-methods
  tsdfuse evaluate kitti/sequences/00 --scans 0..200 --method-set raycast:map.voxel_size_m=0.1,map.truncation_m=0.3
  tsdfuse evaluate kitti/sequences/00 --methods patch,raycast --poses given,refine,track
  tsdfuse evaluate kitti/sequences/00 --methods patch,raycast --pose-noise 0.03,0.15
  tsdfuse evaluate kitti/sequences/00 --tune --budget 600";

/// Compare methods on a log: error, completeness, held-out scans, speed and memory, as tables and an illustrated report.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[arg(long, value_name = "NAMES", value_delimiter = ',',
        help = format!("Methods to compare: all, or some of {} [default: all, or none with --method-set]", Form::names().join(", ")))]
    methods: Vec<String>,
    /// Also compare a method with these settings: METHOD:KEY=VALUE[,KEY=VALUE].
    #[arg(long, value_name = "SET")]
    method_set: Vec<String>,
    /// Write report.html, table.md, results.json and methods.png to this folder.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Print the results as JSON on standard output instead of tables.
    #[arg(long)]
    json: bool,
    /// Hold out the middle one of every K scans; 0: none [default: 10, or less for short logs].
    #[arg(long, value_name = "K")]
    hold_out: Option<u32>,
    #[arg(long, value_name = "M", help = format!(
        "Largest distance between a held-out return and its surface, metres [default: {}, or {DEPTH_CAMERA_TRUNCATION_M} for depth cameras]",
        MapConfig::default().truncation_m))]
    margin: Option<f64>,
    /// Add normally distributed errors to the poses of fused scans, not to those of held-out ones: standard deviations along
    /// and about each axis, metres and degrees
    #[arg(long, value_name = "M,DEG", conflicts_with = "tune")]
    pose_noise: Option<String>,
    /// What meshes are compared with: a mesh or a cloud (.ply), or a log for the points of its scans.
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// If scan points are the reference, use only every N-th scan.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// The rules of measurement [default: surface if the reference is a mesh, thesis if it is points].
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(Protocol::NAMES))]
    protocol: Option<String>,
    /// Number of samples on each mesh [default: the protocol's].
    #[arg(long, value_name = "N")]
    samples: Option<usize>,
    /// Number of runs per method; the median speed is shown. A single run is quicker, but its speed is noisy.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    runs: u32,
    /// Camera position and target of a picture, world frame, metres; may be repeated [default: from above and twice from the
    /// sensor].
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = parse_view, allow_hyphen_values = true)]
    view: Vec<[DVec3; 2]>,
    /// The error at the bright end of the colours, metres.
    #[arg(long, value_name = "M", default_value_t = 0.05)]
    max_error: f64,
    /// Keep the meshes (.ply) in the output folder.
    #[arg(long, requires = "output")]
    keep_meshes: bool,
    /// Search method, voxel size and truncation by held-out error instead, and print the command to use.
    #[arg(long)]
    tune: bool,
    /// Time limit of the search, seconds.
    #[arg(long, value_name = "SECS", default_value_t = 300.0, requires = "tune")]
    budget: f64,
    #[command(flatten)]
    log: LogArgs,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let forms = Form::chosen(&args.methods, &args.method_set).map_err(told)?;
    if args.tune {
        args.log.check_poses_known()?;
        return tune(args, forms);
    }
    let forms = match args.poses()? {
        Some(poses) => Form::with_poses(&forms, &poses),
        None => forms,
    };
    let evaluation = args.evaluation(forms)?;
    args.log.set_threads()?;
    let mut bars = Bars::default();
    let found = evaluation.run(&mut run_job::in_own_process(args.log.threads), &mut |p| bars.show(&p));
    let Evaluated {
        results,
        files,
        sheet_rows,
    } = found.map_err(told)?;
    for file in &files {
        let is_sheet = file.extension().is_some_and(|e| e == "png");
        let rows = if is_sheet {
            format!(" (row by row: {sheet_rows})")
        } else {
            String::new()
        };
        say(format_args!("  wrote    {}{rows}", file.display()));
    }
    if args.json {
        print_json(&results)?;
    } else {
        let texts: Vec<_> = tables::of(&results)
            .iter()
            .map(tsdfuse_evaluate::table::Table::text)
            .collect();
        print(&texts.join("\n"))?;
    }
    for row in &results.methods {
        let warnings = row.surface.warnings.iter();
        warnings.for_each(|warning| note(format_args!("{}: {warning}", row.form.name)));
    }
    for failed in &results.failed {
        note(format_args!("{}: {}", failed.name, failed.reason));
    }
    Ok(outcome(results.methods.iter().all(|row| row.skipped_scans.is_empty())))
}

fn tune(args: &Args, forms: Vec<Form>) -> Result<Outcome> {
    let tuning = Tuning {
        contest: args.contest(forms)?,
        budget_secs: args.budget,
    };
    args.log.set_threads()?;
    let mut bars = Bars::default();
    let found = tuning.run(&mut |p| bars.show(&p)).map_err(told)?;
    for skipped in &found.skipped_scans {
        say(format_args!(
            "tsdfuse: warning: skipped {}: {}",
            skipped.name, skipped.reason
        ));
    }
    print_results(&found, args.json, Tuned::text)?;
    Ok(outcome(found.skipped_scans.is_empty()))
}

fn outcome(is_complete: bool) -> Outcome {
    if is_complete {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    }
}

impl Args {
    /// The kinds of poses that are compared, if `--poses` lists kinds: `given,refine,track`.
    fn poses(&self) -> Result<Option<Vec<ScanPoses>>> {
        let Some(text) = self.log.poses.as_deref().and_then(Path::to_str) else {
            return Ok(None);
        };
        let kind = |word: &str| ScanPoses::ALL.into_iter().find(|kind| kind.name() == word);
        let words: Vec<&str> = text.split(',').collect();
        if !words.iter().any(|word| kind(word).is_some()) {
            return Ok(None);
        }
        let kinds: Option<Vec<ScanPoses>> = words.iter().map(|word| kind(word)).collect();
        match kinds {
            Some(kinds) if (1..kinds.len()).all(|i| !kinds[..i].contains(&kinds[i])) => Ok(Some(kinds)),
            _ => Err(Usage::new(format!(
                "--poses {text}: expected given, refine and track, each once, or a file"
            ))
            .into()),
        }
    }

    fn contest(&self, forms: Vec<Form>) -> Result<Contest> {
        let mut input = self.log.input();
        if self.poses()?.is_some() {
            input.options.poses = None;
        }
        Ok(Contest {
            input,
            settings: self.log.settings(None)?,
            forms,
            hold_out: self.hold_out.map(|every| every as usize),
            margin_m: self.margin,
            pose_noise: self
                .pose_noise
                .as_deref()
                .map(PoseNoise::parse)
                .transpose()
                .map_err(told)?,
        })
    }

    fn evaluation(&self, forms: Vec<Form>) -> Result<Evaluation> {
        Ok(Evaluation {
            contest: self.contest(forms)?,
            comparing: Comparing {
                reference: self.reference.clone(),
                every: self.every as usize,
                protocol: self.protocol.clone(),
                samples: self.samples,
            },
            runs: self.runs as usize,
            views: self.view.clone(),
            max_error_m: self.max_error,
            config_file: self.log.config.clone(),
            output: self.output.clone(),
            keep_meshes: self.keep_meshes,
            command_line: command_line(),
        })
    }
}

fn parse_view(text: &str) -> Result<[DVec3; 2], String> {
    let wanted = || "expected six numbers: x,y,z of the camera, and those of its target".to_owned();
    let third_comma = text.match_indices(',').nth(2).ok_or_else(wanted)?.0;
    let [from, to] = [&text[..third_comma], &text[third_comma + 1..]].map(parse_triple);
    let view = [from.map_err(|_| wanted())?, to.map_err(|_| wanted())?];
    if view[0] == view[1] {
        return Err("the camera is at its target".to_owned());
    }
    Ok(view)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_two_places() {
        assert_eq!(
            parse_view("1,2,3,-4,5.5,6"),
            Ok([DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 5.5, 6.0)])
        );
        for bad in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,3,4,5,x",
            "1,2,3,4,5,6,7",
            "1,2,3,1,2,3",
            "1,2,3,4,5,nan",
        ] {
            assert!(parse_view(bad).is_err(), "{bad}");
        }
    }
}
