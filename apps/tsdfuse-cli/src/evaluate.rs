//! `tsdfuse evaluate`: methods side by side on a data set, as tables, plots and pictures.

mod args;
mod child;
pub(crate) mod forms;
mod page;
mod pictures;
mod plots;
mod reference;
pub(crate) mod results;
mod tables;
mod tune;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tempfile::TempDir;
use tsdfuse::Mesh;
use tsdfuse::render::{RenderConfig, Renderer};
use tsdfuse_eval::held_out::{Collector, HeldOut};
use tsdfuse_eval::stats::Histogram;
use tsdfuse_io::Dataset;
use tsdfuse_io::geometry::{self, Geometry};

pub(crate) use args::Args;

use crate::config::{RunConfig, Suggested};
use crate::exit::{Outcome, Usage, one_line};
use crate::machine::Machine;
use crate::progress::{self, note, say};
use crate::report::{command_line, print, print_json};
use crate::settings::split;
use child::{FuseReport, Skipped, Wanted};
use forms::Form;
use pictures::{Gallery, Views};
use reference::Chosen;
use results::{Data, Results, Row, Speed};
use tables::Table;

/// One of so many scans is held out, unless that is asked for otherwise.
const HOLD_OUT: u32 = 10;

/// Bins of a histogram of held-out errors, 0 to the margin.
const BINS: usize = 100;

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let forms = Form::chosen(&args.methods, &args.method_set)?;
    // Before the work, not after it.
    for form in &forms {
        let mut layers = args.settings.layers(Some(form.method.name()))?;
        form.settings.iter().try_for_each(|setting| layers.set_text(setting))?;
    }
    if args.tune {
        return tune::run(args, &forms);
    }
    args.settings.set_threads()?;
    let folder = Folder::create(args.output.as_deref())?;
    let dataset = args.settings.open()?;
    let evaluation = Evaluation::new(args, &dataset, &folder)?;
    let (results, gallery) = evaluation.run(&forms)?;
    let tables = tables::of(&results);
    if let Some(output) = &args.output {
        write(output, &results, &tables, &gallery)?;
    }
    if args.json {
        print_json(&results)?;
    } else {
        let texts: Vec<_> = tables.iter().map(Table::text).collect();
        print(&texts.join("\n"))?;
    }
    for row in &results.methods {
        let warnings = row.surface.warnings.iter();
        warnings.for_each(|warning| note(format_args!("{}: {warning}", row.form.name)));
    }
    results
        .failed
        .iter()
        .for_each(|failed| note(format_args!("{}: {}", failed.name, failed.reason)));
    Ok(match results.methods.iter().all(|row| row.skipped_scans.is_empty()) {
        true => Outcome::Complete,
        false => Outcome::ScansSkipped,
    })
}

/// Where files go while methods run.
struct Folder {
    temporary: TempDir,
}

impl Folder {
    fn create(output: Option<&Path>) -> Result<Self> {
        let temporary = match output {
            None => tempfile::tempdir(),
            Some(output) => {
                fs::create_dir_all(output).with_context(|| output.display().to_string())?;
                tempfile::Builder::new().prefix(".work-").tempdir_in(output)
            }
        };
        Ok(Self {
            temporary: temporary.context("no folder for meshes and maps can be made")?,
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.temporary.path().join(name)
    }
}

/// What all methods are compared on.
struct Evaluation<'a> {
    args: &'a Args,
    dataset: &'a Dataset,
    folder: &'a Folder,
    indices: Vec<usize>,
    hold_out: Option<u32>,
    held_out: Vec<usize>,
    margin_m: f64,
    chosen: Chosen,
}

impl<'a> Evaluation<'a> {
    fn new(args: &'a Args, dataset: &'a Dataset, folder: &'a Folder) -> Result<Self> {
        let indices = args.settings.indices(dataset.len())?;
        let hold_out = match args.hold_out {
            Some(0) => None,
            Some(1) => bail!(Usage::new(
                "--hold-out 1 would hold out every scan; 2 or more, or 0 for none, is wanted"
            )),
            Some(every) => Some(every),
            None if indices.len() < 2 => bail!(Usage::new(
                "one scan is too few to hold one out; --hold-out 0 holds out none"
            )),
            None => Some(HOLD_OUT.min(indices.len() as u32)),
        };
        let (_, held_out) = split(&indices, hold_out)?;
        let suggested = Suggested::by(dataset);
        let margin_m = args.margin_m(suggested.camera.is_some())?;
        let range = args.settings.layers(None)?.resolve(&suggested)?.range;
        let chosen = Chosen::by(args, dataset, &indices, range)?;
        chosen.protocol.check().map_err(Usage::new)?;
        Ok(Self {
            args,
            dataset,
            folder,
            indices,
            hold_out,
            held_out,
            margin_m,
            chosen,
        })
    }

    fn run(self, forms: &[Form]) -> Result<(Results, Gallery)> {
        let mut methods: Vec<Row> = Vec::new();
        let mut failed = Vec::new();
        let mut pictures = None;
        let bar = progress::steps("evaluating", forms.len());
        for form in forms {
            bar.set_message(form.name.clone());
            match self.row(form) {
                Ok((row, mesh)) => {
                    self.draw(&mut pictures, &form.name, &mesh)?;
                    methods.push(row);
                }
                // Who asks for several wants those that there are.
                Err(error) if forms.len() > 1 => failed.push(Skipped {
                    name: form.name.clone(),
                    reason: one_line(&error),
                }),
                Err(error) => return Err(error.context(form.name.clone())),
            }
            bar.inc(1);
        }
        drop(bar);
        if let (true, Some(Skipped { name, reason })) = (methods.is_empty(), failed.first()) {
            bail!("no method could be used; {name}: {reason}");
        }
        let own = &self.args.settings.dataset;
        // Where on this machine it lies is nobody's business.
        let full = own.canonicalize().ok();
        let name = match own.is_relative() && own.file_name().is_some() {
            true => own.as_os_str(),
            false => full.as_deref().and_then(Path::file_name).unwrap_or(own.as_os_str()),
        };
        let results = Results {
            version: env!("CARGO_PKG_VERSION"),
            command_line: command_line(),
            machine: Machine::here(methods.first().map_or(0, |row| row.threads)),
            dataset: Data {
                name: name.to_string_lossy().into_owned(),
                format: self.dataset.format(),
                scans: self.indices.len(),
                hold_out: self.hold_out,
                held_out_scans: self.held_out.len(),
            },
            reference: self.chosen,
            methods,
            failed,
        };
        Ok((results, pictures.map_or_else(Gallery::default, |(_, gallery)| gallery)))
    }

    /// Fuses with one form, all scans and those that are not held out, and measures what came of it.
    fn row(&self, form: &Form) -> Result<(Row, Mesh)> {
        let settings = &self.args.settings;
        let stem = form.file_stem();
        let [path, report] = ["ply", "json"].map(|extension| self.folder.path(&format!("{stem}.{extension}")));
        let wanted = Wanted {
            mesh: Some(&path),
            ..Wanted::default()
        };
        let runs = (0..self.args.runs).map(|_| child::fuse(settings, form, wanted, &report));
        let mut runs = runs.collect::<Result<Vec<FuseReport>>>()?;
        let scans_per_sec: Vec<f64> = runs.iter().map(|run| Speed::of(run).scans_per_sec).collect();
        let peak_memory_bytes = runs.iter().filter_map(|run| run.peak_memory_bytes).max();
        runs.sort_by(|a, b| Speed::of(a).scans_per_sec.total_cmp(&Speed::of(b).scans_per_sec));
        let run = runs.swap_remove((runs.len() - 1) / 2);

        let Geometry::Mesh(mesh) = geometry::read(&path)? else {
            bail!("it gives no surface");
        };
        if let (true, Some(output)) = (self.args.keep_meshes, &self.args.output) {
            let kept = output.join(format!("{stem}.ply"));
            fs::rename(&path, &kept).with_context(|| kept.display().to_string())?;
        } else {
            fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
        let (held_out, held_out_histogram) = match self.held_out(form, &run.config)? {
            Some((result, histogram)) => (Some(result), Some(histogram)),
            None => (None, None),
        };
        let row = Row {
            form: form.clone(),
            command: form.command(settings),
            surface: tsdfuse_eval::compare(&mesh, &self.chosen.reference, &self.chosen.protocol)?,
            held_out,
            held_out_histogram,
            speed: Speed::of(&run),
            scans_per_sec,
            peak_memory_bytes,
            threads: run.threads,
            map_bytes: run.map.bytes,
            map_blocks: run.map.blocks,
            triangles: mesh.triangles.len(),
            mesh_secs: run.mesh.map_or(f64::NAN, |mesh| mesh.seconds),
            fused_share: run.totals.fused as f64 / (run.totals.points - run.totals.dropped.total()) as f64,
            scan_secs: run.scans.iter().map(|scan| scan.prepare + scan.fuse).collect(),
            config: run.config,
            skipped_scans: run.skipped_scans,
        };
        Ok((row, mesh))
    }

    /// Fuses without the held-out scans and sees how well these are foretold.
    fn held_out(&self, form: &Form, config: &RunConfig) -> Result<Option<(HeldOut, Histogram)>> {
        if self.held_out.is_empty() {
            return Ok(None);
        }
        let [map, report] = ["map.tsdf", "report.json"].map(|name| self.folder.path(name));
        let wanted = Wanted {
            map: Some(&map),
            hold_out: self.hold_out,
            ..Wanted::default()
        };
        child::fuse(&self.args.settings, form, wanted, &report)?;
        let map = tsdfuse_io::map_file::read(&map)?;
        let renderer = Renderer::new(
            &map,
            &RenderConfig {
                min_weight: config.mesh.min_weight,
                ..Default::default()
            },
        )?;
        let mut collector = Collector::new(self.margin_m);
        for read in self.dataset.iter_indices(self.held_out.clone()) {
            let mut scan = match read.scan {
                Ok(scan) => scan,
                Err(_) if self.args.settings.skip_bad => continue,
                Err(error) => return Err(error.into()),
            };
            scan.drop_invalid(&config.range);
            collector.add(&renderer, &scan);
        }
        let result = collector.result().context("the held-out scans have no valid return")?;
        let errors: Vec<f64> = collector.errors_m().iter().map(|e| e.abs()).collect();
        Ok(Some((
            result,
            Histogram::of(&errors, self.margin_m / BINS as f64, BINS),
        )))
    }

    /// Draws a mesh, if pictures go anywhere; the first one decides where from.
    fn draw(&self, pictures: &mut Option<(Views, Gallery)>, name: &str, mesh: &Mesh) -> Result<()> {
        if self.args.output.is_none() {
            return Ok(());
        }
        if pictures.is_none() {
            let scans = self.dataset.scans();
            let poses: Vec<_> = self.indices.iter().map(|&index| scans[index].pose).collect();
            let views = Views::choose(self.args, &poses, mesh);
            let mut gallery = Gallery::new(&views);
            gallery.add_reference(&views, &self.chosen)?;
            *pictures = Some((views, gallery));
        }
        match pictures {
            Some((views, gallery)) => gallery.add_mesh(views, name, mesh, &self.chosen),
            None => Ok(()),
        }
    }
}

/// Writes everything into the folder.
fn write(folder: &Path, results: &Results, tables: &[Table], gallery: &Gallery) -> Result<()> {
    let plots = plots::of(results)?;
    let markdown: Vec<_> = tables.iter().map(Table::markdown).collect();
    let files = [
        ("results.json", serde_json::to_string_pretty(results)? + "\n"),
        ("table.md", markdown.join("\n")),
        ("report.html", page::of(results, tables, &plots, gallery)),
    ];
    for (name, text) in files {
        tsdfuse_io::atomic::write(folder.join(name), |file| file.write_all(text.as_bytes()))?;
        say(format_args!("  wrote    {}", folder.join(name).display()));
    }
    let (sheet, order) = gallery.contact_sheet();
    let path = folder.join("methods.png");
    tsdfuse_io::png::write(&path, &sheet)?;
    say(format_args!("  wrote    {} (row by row: {order})", path.display()));
    Ok(())
}
