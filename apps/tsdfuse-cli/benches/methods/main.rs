//! All methods side by side, on simulated sequences whose true surface is known, as tables for BENCHMARKS.md.
//!
//! ```text
//! cargo bench -p tsdfuse-cli --bench methods -- [--runs N] [--scenes street,hall] [--methods raycast,normals] [--quick]
//!                                               [--pictures docs/images]
//! ```
//!
//! The command itself does the work, `tsdfuse fuse --report`; its map is then measured here, and its mesh drawn: whole, with what
//! faces away in black, which a view by `tsdfuse render` does not show.

mod measure;
mod pictures;
mod table;
mod truth;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use serde_json::Value;
use tsdfuse::Mesh;
use tsdfuse::fuse::Method;
use tsdfuse::glam::DVec3;
use tsdfuse::mesh::{self, MeshConfig};
use tsdfuse_sim::NoiseModel;

use pictures::Sheet;
use table::{Row, Run, median};
use truth::{SEQUENCES, Sequence};

/// Surface within this of the truth is right, truth within this of the surface is covered; metres.
const TOLERANCE_M: f64 = 0.05;

/// Points on each mesh that are measured.
const SAMPLES: usize = 1_000_000;

/// Forms of a method other than its default.
const FORMS: &[(Method, &str, &[&str])] = &[
    (Method::Raycast, "projective", &["raycast.distance=projective"]),
    (Method::Normals, "Holz", &["normals.estimator=holz"]),
    (Method::Surfel, "ground flip", &["surfel.ground_flip=true"]),
    (Method::Roldao, "batch", &["roldao.form=batch"]),
];

/// Compare all methods on simulated sequences.
#[derive(Debug, Parser)]
struct Args {
    /// Runs of each method, for the range of its speed.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Only these scenes.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = ["street", "hall"])]
    scenes: Vec<String>,
    /// Only these methods, in all their forms.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    methods: Vec<Method>,
    /// One run of a quarter of the scans: to see whether all works.
    #[arg(long)]
    quick: bool,
    /// Draw the meshes into methods-SCENE.png in this folder.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// What cargo says.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<()> {
    // `cargo test --benches` only wants to know that this builds.
    let told = |flag: &str| std::env::args().any(|a| a == flag);
    if !told("--bench") || told("--test") {
        return Ok(());
    }
    let args = Args::parse();
    for mut sequence in SEQUENCES {
        if !args.scenes.is_empty() && !args.scenes.iter().any(|s| s == sequence.scene) {
            continue;
        }
        if args.quick {
            sequence.scans /= 4;
        }
        compare(&args, &sequence)?;
    }
    Ok(())
}

/// Prints the table of one sequence, line by line.
fn compare(args: &Args, sequence: &Sequence) -> Result<()> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let data = sequence.written(folder)?;
    let truth = sequence.simulator(NoiseModel::none())?.scene().clone();
    let mut drawn = vec!["true surface".to_owned()];
    let mut sheet = args.pictures.is_some().then(|| Sheet::new(&truth, &sequence.views));
    let bench = Bench {
        data: data.to_string_lossy().into_owned(),
        runs: if args.quick { 1 } else { args.runs },
        truth,
        hits: sequence.hits(TOLERANCE_M)?,
    };
    let Sequence {
        scene, sensor, scans, ..
    } = sequence;
    print(&format!(
        "\n**{scene}**: {scans} scans of {sensor}; true surface in {} cells of 5 cm.\n\n{}",
        bench.hits.len(),
        table::HEADER
    ))?;
    let forms = Method::ALL.iter().flat_map(|&method| {
        let others = FORMS.iter().filter(move |form| form.0 == method);
        std::iter::once((method, "", &[][..])).chain(others.copied())
    });
    for (method, form, settings) in forms.filter(|f| args.methods.is_empty() || args.methods.contains(&f.0)) {
        let name = match form {
            "" => format!("`{}`", method.name()),
            _ => format!("`{}`, {form}", method.name()),
        };
        match bench.row(method, &name, settings) {
            Ok((row, mesh)) => {
                print(&row.line())?;
                sheet.iter_mut().for_each(|sheet| sheet.add(&mesh));
                drawn.push(name);
            }
            Err(error) => say(&format!("{scene}: {name}: {error:#}")),
        }
    }
    if let Some((folder, sheet)) = args.pictures.as_ref().zip(sheet) {
        // Cargo runs benches in the package's folder, people call it from the workspace's.
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let path = workspace.join(folder).join(format!("methods-{scene}.png"));
        sheet.write(&path).with_context(|| path.display().to_string())?;
        say(&format!(
            "{}: row by row, two views of each: {}",
            path.display(),
            drawn.join(", ")
        ));
    }
    Ok(())
}

/// One sequence and its truth.
struct Bench {
    data: String,
    runs: u32,
    truth: tsdfuse_sim::Scene,
    hits: Vec<DVec3>,
}

impl Bench {
    fn row(&self, method: Method, name: &str, settings: &[&str]) -> Result<(Row, Mesh)> {
        let start = Instant::now();
        let [mesh, map, report] = ["mesh.ply", "map.tsdf", "report.json"].map(|n| format!("{}.{n}", self.data));
        let mut arguments = vec!["fuse", &self.data, "--method", method.name(), "-o", &mesh];
        arguments.extend(["--save-map", &map, "--report", &report]);
        arguments.extend(settings.iter().flat_map(|s| ["--set", s]));
        let runs = (0..self.runs).map(|_| {
            run_tsdfuse(&arguments)?;
            medians(&serde_json::from_slice(&std::fs::read(&report)?)?)
        });
        let runs = runs.collect::<Result<Vec<Run>>>()?;
        let fused = start.elapsed();

        // The very mesh that was written, before its rounding to the file's 32 bits.
        let mesh = mesh::extract_with(&tsdfuse_io::map_file::read(&map)?, &MeshConfig::default())?;
        let accuracy = measure::accuracy(&mesh, SAMPLES, TOLERANCE_M, |p| self.truth.signed_distance(p));
        let row = Row {
            name: name.to_owned(),
            runs,
            accuracy: accuracy.context("no surface")?,
            completeness: measure::completeness(&mesh, &self.hits, TOLERANCE_M),
        };
        let measured = start.elapsed() - fused;
        say(&format!(
            "{name}: fused {} times in {fused:.1?}, measured in {measured:.1?}",
            self.runs
        ));
        Ok((row, mesh))
    }
}

/// The figures of one run, from its report.
fn medians(report: &Value) -> Result<Run> {
    let scans = report["scans"].as_array().context("a report without scans")?;
    let of = |value: &dyn Fn(&Value) -> f64| {
        let mut values: Vec<f64> = scans.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        median(&values)
    };
    let seconds = |scan: &Value, key: &str| scan[key].as_f64().unwrap_or(f64::NAN);
    // What a method leaves to the end, spread over the scans.
    let finish = seconds(&report["totals"]["finish"], "seconds") / scans.len() as f64;
    Ok(Run {
        prepare_secs: of(&|scan| seconds(scan, "prepare")),
        fuse_secs: of(&|scan| seconds(scan, "fuse")) + finish,
        scan_secs: of(&|scan| seconds(scan, "prepare") + seconds(scan, "fuse")) + finish,
        peak_memory_bytes: report["peak_memory_bytes"].as_f64().unwrap_or(f64::NAN),
    })
}

/// Runs the command; what it says is only told if it fails.
fn run_tsdfuse(arguments: &[&str]) -> Result<()> {
    let done = Command::new(env!("CARGO_BIN_EXE_tsdfuse")).args(arguments).output()?;
    let told = String::from_utf8_lossy(&done.stderr);
    ensure!(
        done.status.success(),
        "{}",
        told.trim().lines().last().unwrap_or_default()
    );
    Ok(())
}

/// Progress, on standard error.
fn say(line: &str) {
    // Nobody may be listening.
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Results, on standard output.
fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())?;
    Ok(out.flush()?)
}
