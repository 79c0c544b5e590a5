//! Methods side by side on a log: each fuses all scans, its mesh is compared with a reference, and its map of some scans with
//! the others.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use tsdfuse::{Mesh, Pose};
use tsdfuse_eval::held_out::HeldOut;
use tsdfuse_eval::stats::Histogram;
use tsdfuse_io::geometry::{self, Geometry};
use tsdfuse_io::{Log, Selection};
use tsdfuse_run::{Job, Machine, Outputs, Report, RunConfig};

use crate::colored;
use crate::command;
use crate::error::{Error, Result};
use crate::evaluation::{Evaluated, Evaluation, Runner};
use crate::folder::Folder;
use crate::form::Form;
use crate::held_out::{self, HeldOutScans};
use crate::page;
use crate::pictures::{Gallery, Views};
use crate::placed::{self, PlacedLog};
use crate::plots;
use crate::progress::{Progress, Watch};
use crate::reference;
use crate::results::{Data, Failed, Results, Row, Speed};
use crate::table::Table;
use crate::tables;
use crate::truth::Truth;

/// One of so many scans is held out, unless that is asked for otherwise.
const HOLD_OUT: usize = 10;

/// Bins of a histogram of held-out errors, 0 to the margin.
const BINS: usize = 100;

impl Evaluation {
    /// Measures everything, and writes the files.
    ///
    /// # Errors
    /// [`Error::Config`] before any work for options that do not fit together. If no method can be used, or a file cannot be
    /// written. A method that cannot be used is no error as long as there are others: see [`Results::failed`].
    pub fn run(&self, runner: &mut Runner<'_>, watch: &mut Watch<'_>) -> Result<Evaluated> {
        self.check()?;
        let poses = tempfile::tempdir().map_err(Error::at(&std::env::temp_dir()))?;
        let logs = placed::logs(&self.contest, poses.path(), watch)?;
        let place = Workplace::new(self, &logs, watch)?;
        let (methods, failed, gallery) = place.run(runner, watch)?;
        let (results, folder) = place.results(methods, failed);
        let files = match folder.output() {
            Some(output) => write(output, &results, &gallery)?,
            None => Vec::new(),
        };
        Ok(Evaluated {
            results,
            files,
            sheet_rows: gallery.contact_sheet().1,
        })
    }
}

/// What all methods have in common.
struct Workplace<'a> {
    asked: &'a Evaluation,
    /// With each kind of poses.
    logs: &'a [PlacedLog],
    /// The first of them.
    log: &'a Log,
    indices: Vec<usize>,
    /// Which scans are fused, where some are held out.
    selection: Selection,
    held_out: HeldOutScans,
    truth: Truth,
    folder: Folder,
}

impl<'a> Workplace<'a> {
    fn new(asked: &'a Evaluation, logs: &'a [PlacedLog], watch: &mut Watch<'_>) -> Result<Self> {
        let Some(PlacedLog { log, .. }) = logs.first() else {
            return Err(Error::config("there is no method to evaluate"));
        };
        let contest = &asked.contest;
        let input = &contest.input;
        let scans = reference::length(log)?;
        for form in &contest.forms {
            form.over(&contest.settings)?.resolve(log)?;
        }
        let range = contest.settings.resolve(log)?.range;
        let selection = held_out::selection(&input.selection, contest.hold_out, HOLD_OUT, scans)?;
        let held_out = HeldOutScans::of(&selection, scans, contest.margin_m(log), input.skip_bad);
        if let Some(output) = &asked.output {
            let others = [&input.options.poses, &asked.comparing.reference, &asked.config_file];
            let others = others.into_iter().flatten().map(PathBuf::as_path);
            let inputs: Vec<&Path> = std::iter::once(input.path.as_path()).chain(others).collect();
            Folder::check(output, &asked.files(), &inputs)?;
        }
        let indices = input.selection.indices(scans);
        let truth = asked.comparing.read(&input.path, log, &indices, &range, watch)?;
        Ok(Self {
            asked,
            logs,
            log,
            indices,
            selection,
            held_out,
            truth,
            folder: Folder::create(asked.output.as_deref())?,
        })
    }

    fn run(&self, runner: &mut Runner<'_>, watch: &mut Watch<'_>) -> Result<(Vec<Row>, Vec<Failed>, Gallery)> {
        let Evaluation { contest, runs, .. } = self.asked;
        let forms = &contest.forms;
        watch(Progress::Begun {
            work: "evaluating",
            steps: Some(forms.len() * (*runs).max(1)),
        });
        let (mut rows, mut failed) = (Vec::new(), Vec::new());
        let mut pictures = None;
        for form in forms {
            watch(Progress::At(&form.name));
            match self.measure(form, runner) {
                Ok((row, report, mesh)) => {
                    self.draw(&mut pictures, &form.name, &mesh)?;
                    rows.push((row, vec![report]));
                }
                // Who asks for several methods wants those that there are.
                Err(error) if forms.len() > 1 => failed.push(Failed {
                    name: form.name.clone(),
                    reason: error.to_string(),
                }),
                Err(error) => return Err(Error::failed(format_args!("{}: {error}", form.name))),
            }
            watch(Progress::Step);
        }
        if let (true, Some(Failed { name, reason })) = (rows.is_empty(), failed.first()) {
            return Err(Error::failed(format_args!("no method could be run; {name}: {reason}")));
        }
        for _ in 1..*runs {
            for (row, reports) in &mut rows {
                watch(Progress::At(&row.form.name));
                match self.fuse(&row.form, &self.folder.temporary("again.ply"), runner) {
                    Ok(report) => reports.push(report),
                    Err(error) => watch(Progress::Note(&format!("{}: a run failed: {error}", row.form.name))),
                }
                watch(Progress::Step);
            }
        }
        watch(Progress::Done);
        let with_speeds = |(mut row, reports): (Row, Vec<Report>)| {
            row.set_speeds(reports);
            row
        };
        let methods = rows.into_iter().map(with_speeds).collect();
        let gallery = pictures.map_or_else(Gallery::default, |(_, gallery)| gallery);
        Ok((methods, failed, gallery))
    }

    fn results(self, methods: Vec<Row>, failed: Vec<Failed>) -> (Results, Folder) {
        let results = Results {
            version: env!("CARGO_PKG_VERSION"),
            command_line: self.asked.command_line.clone(),
            machine: Machine::here(methods.first().map_or(0, |row| row.threads)),
            dataset: Data {
                name: name_of(&self.asked.contest.input.path),
                format: self.log.format().to_owned(),
                scans: self.indices.len(),
                hold_out: self.selection.hold_out,
                held_out_scans: self.held_out.indices.len(),
                pose_noise: self.asked.contest.pose_noise,
            },
            reference: self.truth,
            methods,
            failed,
        };
        (results, self.folder)
    }

    /// The log with the poses that a form fuses with.
    fn placed(&self, form: &Form) -> &PlacedLog {
        let own = self.logs.iter().find(|placed| placed.poses == form.poses);
        own.unwrap_or(&self.logs[0])
    }

    fn job(&self, form: &Form) -> Result<Job> {
        Ok(Job {
            input: self.placed(form).input.clone(),
            settings: form.over(&self.asked.contest.settings)?,
            ..Job::default()
        })
    }

    /// Fuses all scans into a mesh.
    fn fuse(&self, form: &Form, mesh: &Path, runner: &mut Runner<'_>) -> Result<Report> {
        let mut job = self.job(form)?;
        job.outputs.mesh = Some(mesh.to_owned());
        runner(&job).map_err(Error::Failed)
    }

    /// Fuses with one form, all scans and those that are not held out, and measures what came of it.
    fn measure(&self, form: &Form, runner: &mut Runner<'_>) -> Result<(Row, Report, Mesh)> {
        let path = self.folder.temporary(&form.mesh_name());
        let report = self.fuse(form, &path, runner)?;
        let Geometry::Mesh(mesh) = geometry::read(&path)? else {
            return Err(Error::failed("it gives no surface"));
        };
        match self.folder.output().filter(|_| self.asked.keep_meshes) {
            Some(output) => {
                let kept = output.join(form.mesh_name());
                fs::rename(&path, &kept).map_err(Error::at(&kept))?;
            }
            None => fs::remove_file(&path).map_err(Error::at(&path))?,
        }
        let (held_out, held_out_histogram) = self.held_out(form, &report.config, runner)?.unzip();
        let command = Job {
            outputs: Outputs {
                mesh: Some("mesh.ply".into()),
                ..Outputs::default()
            },
            input: self.asked.contest.input.clone(),
            poses: form.poses.from(),
            ..self.job(form)?
        };
        let sums = &report.totals.sums;
        let row = Row {
            form: form.clone(),
            command: command::of(&command),
            surface: tsdfuse_eval::compare(&mesh, &self.truth.reference, &self.truth.protocol)?,
            held_out,
            held_out_histogram,
            speed: Speed::of(&report),
            scans_per_sec: Vec::new(),
            peak_memory_bytes: None,
            threads: report.threads,
            map_bytes: report.map.bytes as u64,
            map_blocks: report.map.blocks,
            triangles: mesh.triangles.len(),
            mesh_secs: f64::NAN,
            fused_share: sums.fused as f64 / (sums.points - sums.dropped.total()) as f64,
            scan_secs: Vec::new(),
            config: report.config.clone(),
            skipped_scans: report.skipped_scans.clone(),
        };
        Ok((row, report, mesh))
    }

    /// Fuses without the held-out scans, and looks how well the map predicts these.
    fn held_out(
        &self,
        form: &Form,
        config: &RunConfig,
        runner: &mut Runner<'_>,
    ) -> Result<Option<(HeldOut, Histogram)>> {
        if self.selection.hold_out.is_none() {
            return Ok(None);
        }
        let path = self.folder.temporary("map.tsdf");
        let mut job = self.job(form)?;
        job.input.selection = self.selection.clone();
        job.outputs.map = Some(path.clone());
        runner(&job).map_err(Error::Failed)?;
        let map = tsdfuse_io::map_file::read(&path)?;
        fs::remove_file(&path).map_err(Error::at(&path))?;
        let (collector, _) = self.held_out.measure(&self.placed(form).log, &map, config)?;
        let errors: Vec<f64> = collector.errors_m().iter().map(|e| e.abs()).collect();
        let histogram = Histogram::of(&errors, self.held_out.margin_m / BINS as f64, BINS);
        Ok(collector.result().map(|result| (result, histogram)))
    }

    /// Draws a mesh, if pictures go anywhere; the first one decides where from.
    fn draw(&self, pictures: &mut Option<(Views, Gallery)>, name: &str, mesh: &Mesh) -> Result<()> {
        let Some(folder) = self.folder.output() else {
            return Ok(());
        };
        let (views, gallery) = match pictures {
            Some(pictures) => pictures,
            none => {
                let scans = self.log.scans();
                let poses: Vec<Pose> = self.indices.iter().filter_map(|&index| scans[index].pose).collect();
                let views = Views::choose(&self.asked.views, self.asked.max_error_m, &poses, mesh);
                let mut gallery = Gallery::new(&views);
                gallery.add_reference(&views, &self.truth.reference)?;
                none.insert((views, gallery))
            }
        };
        let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
        let file = format!("3d-{}.html", name.chars().map(safe).collect::<String>());
        colored::write(
            &folder.join(&file),
            name,
            mesh,
            &self.truth.reference,
            gallery.max_error_m,
        )?;
        gallery.pages.push((name.to_owned(), file));
        gallery.add_mesh(views, name, mesh, &self.truth.reference)
    }
}

/// What results call a log. They may be published, so they do not tell where on this machine it lies.
fn name_of(path: &Path) -> String {
    let full = path.canonicalize().ok();
    let name = if path.is_relative() && path.file_name().is_some() {
        path.as_os_str()
    } else {
        full.as_deref().and_then(Path::file_name).unwrap_or(path.as_os_str())
    };
    name.to_string_lossy().into_owned()
}

/// Writes everything into the folder.
fn write(folder: &Path, results: &Results, gallery: &Gallery) -> Result<Vec<PathBuf>> {
    let (tables, plots) = (tables::of(results), plots::of(results)?);
    let markdown: Vec<_> = tables.iter().map(Table::markdown).collect();
    let json = serde_json::to_string_pretty(results).map_err(Error::failed)?;
    let mut written = Vec::new();
    for (name, text) in [
        ("results.json", json + "\n"),
        ("table.md", markdown.join("\n")),
        ("report.html", page::of(results, &tables, &plots, gallery)),
    ] {
        let path = folder.join(name);
        tsdfuse_io::atomic::write(&path, |file| file.write_all(text.as_bytes()))?;
        written.push(path);
    }
    written.extend(gallery.pages.iter().map(|(_, file)| folder.join(file)));
    let path = folder.join("methods.png");
    tsdfuse_io::png::write(&path, &gallery.contact_sheet().0)?;
    written.push(path);
    Ok(written)
}
