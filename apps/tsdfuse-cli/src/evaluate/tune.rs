//! `--tune`: which method, voxel size and truncation foretell held-out scans best.
//!
//! A coarse grid on few scans, then successive halving (Jamieson and Talwalkar, AISTATS 2016): the better quarter on twice as
//! many scans, until one is left, all scans are used, or time is up. The objective counts what is missing and what is false as
//! much as the largest error, so that leaving holes does not pay.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use serde::Serialize;
use tsdfuse::VoxelMap;
use tsdfuse::render::{RenderConfig, Renderer};
use tsdfuse_eval::held_out::{Collector, HeldOut};
use tsdfuse_io::Dataset;

use super::args::Args;
use super::forms::Form;
use crate::config::{RunConfig, Suggested};
use crate::exit::{Outcome, one_line};
use crate::progress::{self, note};
use crate::report::{print, print_json};
use crate::settings::split;

/// Voxel sizes that are tried, as multiples of the default.
const VOXELS: [f64; 4] = [1.0, 1.6, 0.6, 2.4];

/// Truncations that are tried, in voxels.
const TRUNCATIONS: [f64; 3] = [4.0, 3.0, 6.0];

/// One of so many is kept after each round.
const KEPT: usize = 4;

/// One of so many scans is held out, unless that is asked for otherwise.
const HOLD_OUT: u32 = 5;

/// Candidates that are shown.
const SHOWN: usize = 10;

/// What is tried.
#[derive(Clone, Debug)]
struct Candidate {
    form: Form,
    config: RunConfig,
}

/// How good it was.
#[derive(Clone, Debug, Serialize)]
struct Score {
    name: String,
    voxel_size_m: f64,
    truncation_m: f64,
    /// Fusing, wall time, all cores.
    secs_per_scan: f64,
    held_out: HeldOut,
    /// Makes a mesh with it.
    command: String,
}

/// What the search found.
#[derive(Debug, Serialize)]
struct Found {
    /// Scans of the last round that was completed, of all.
    scans: usize,
    all_scans: usize,
    hold_out: u32,
    /// Candidates there were, and those that were tried.
    candidates: usize,
    tried: usize,
    /// Whether time was up before one was left or all scans were used.
    out_of_time: bool,
    secs: f64,
    /// Of that round, the best first.
    ranking: Vec<Score>,
}

pub(super) fn run(args: &Args, forms: &[Form]) -> Result<Outcome> {
    args.settings.set_threads()?;
    let dataset = args.settings.open()?;
    let suggested = Suggested::by(&dataset);
    let indices = args.settings.indices(dataset.len())?;
    let search = Search {
        args,
        dataset: &dataset,
        suggested: &suggested,
        hold_out: match args.hold_out {
            Some(every) => every,
            None => HOLD_OUT.min(indices.len() as u32),
        },
        margin_m: args.margin_m(suggested.camera.is_some())?,
        start: Instant::now(),
        budget: Duration::try_from_secs_f64(args.budget).ok(),
        indices,
    };
    split(&search.indices, Some(search.hold_out))?;
    let found = search.run(search.candidates(forms)?)?;
    match args.json {
        true => print_json(&found)?,
        false => print(&text(&found))?,
    }
    Ok(Outcome::Complete)
}

struct Search<'a> {
    args: &'a Args,
    dataset: &'a Dataset,
    suggested: &'a Suggested,
    indices: Vec<usize>,
    hold_out: u32,
    margin_m: f64,
    start: Instant,
    /// None: forever.
    budget: Option<Duration>,
}

impl Search<'_> {
    /// Each form with each voxel size and truncation that are not set; the defaults of all forms first.
    fn candidates(&self, forms: &[Form]) -> Result<Vec<Candidate>> {
        let config = |form: &Form, voxel: f64, truncation: f64| {
            let mut layers = self.args.settings.layers(Some(form.method.name()))?;
            form.settings.iter().try_for_each(|setting| layers.set_text(setting))?;
            let is_set = |key: &str| layers.has("map", key);
            let [voxel_is_set, truncation_is_set] = ["voxel_size_m", "truncation_m"].map(is_set);
            let mut config = layers.resolve(self.suggested)?;
            let millimetres = |length_m: f64| (length_m * 1e3).round() / 1e3;
            if !voxel_is_set {
                config.map.voxel_size_m = millimetres(config.map.voxel_size_m * voxel);
            }
            if !truncation_is_set {
                config.map.truncation_m = millimetres(config.map.voxel_size_m * truncation);
            }
            anyhow::Ok(config)
        };
        let mut candidates: Vec<Candidate> = Vec::new();
        for (truncation, voxel) in TRUNCATIONS.iter().flat_map(|t| VOXELS.iter().map(move |v| (*t, *v))) {
            for form in forms {
                let config = config(form, voxel, truncation)?;
                // Where they are set, all sizes are the same, or do not fit together.
                let is_new = !candidates.iter().any(|c| c.form == *form && c.config == config);
                if is_new && config.map.validate().is_ok() {
                    candidates.push(Candidate {
                        form: form.clone(),
                        config,
                    });
                }
            }
        }
        Ok(candidates)
    }

    fn run(&self, mut candidates: Vec<Candidate>) -> Result<Found> {
        let count = candidates.len();
        let all_scans = self.indices.len();
        let mut scans = (2 * self.hold_out as usize).min(all_scans);
        let mut found: Option<Found> = None;
        loop {
            let bar = progress::steps("tuning", candidates.len());
            let mut scored: Vec<(Candidate, Score)> = Vec::new();
            let mut failed: Vec<Form> = Vec::new();
            let mut out_of_time = false;
            for candidate in &candidates {
                let Candidate { form, config } = candidate;
                bar.set_message(format!("{scans} scans: {}, {} m", form.name, config.map.voxel_size_m));
                if !failed.contains(form) {
                    match self.score(candidate, scans) {
                        Ok(Some(score)) => scored.push((candidate.clone(), score)),
                        Ok(None) => {
                            out_of_time = true;
                            break;
                        }
                        Err(error) => {
                            bar.suspend(|| note(format_args!("{}: {}", form.name, one_line(&error))));
                            failed.push(form.clone());
                        }
                    }
                }
                bar.inc(1);
            }
            drop(bar);
            // Only candidates of one round are comparable; the first one counts as far as it came.
            if out_of_time && let Some(found) = found {
                return Ok(Found {
                    out_of_time,
                    secs: self.start.elapsed().as_secs_f64(),
                    ..found
                });
            }
            let error = |(_, score): &(Candidate, Score)| score.held_out.capped_error_m;
            scored.sort_by(|a, b| error(a).total_cmp(&error(b)));
            if scored.is_empty() {
                match out_of_time {
                    true => bail!(
                        "time was up before anything was measured: --budget {} is too short",
                        self.args.budget
                    ),
                    false => bail!("no method could be used"),
                }
            }
            let found = &*found.insert(Found {
                scans,
                all_scans,
                hold_out: self.hold_out,
                candidates: count,
                tried: found.as_ref().map_or(scored.len(), |found| found.tried),
                out_of_time,
                secs: self.start.elapsed().as_secs_f64(),
                ranking: scored.iter().map(|(_, score)| score.clone()).collect(),
            });
            candidates = scored
                .iter()
                .take(scored.len().div_ceil(KEPT))
                .map(|(candidate, _)| candidate.clone())
                .collect();
            if out_of_time || scans == all_scans || found.ranking.len() == 1 {
                break;
            }
            scans = (2 * scans).min(all_scans);
        }
        found.context("nothing was tried")
    }

    fn is_out_of_time(&self) -> bool {
        self.budget.is_some_and(|budget| self.start.elapsed() >= budget)
    }

    /// Fuses so many scans from the middle without the held-out ones, and looks at these; `None` when time is up.
    fn score(&self, candidate: &Candidate, scans: usize) -> Result<Option<Score>> {
        let Candidate { form, config } = candidate;
        let first = (self.indices.len() - scans) / 2;
        let (fused, held_out) = split(&self.indices[first..first + scans], Some(self.hold_out))?;
        let mut map = VoxelMap::new(config.map)?;
        let mut integrator = config.method.build(&config.methods(), self.suggested.sensor.as_ref());
        let mut fusing = Duration::ZERO;
        let count = fused.len();
        for read in self.dataset.iter_indices(fused) {
            if self.is_out_of_time() {
                return Ok(None);
            }
            let mut scan = read.scan?;
            let start = Instant::now();
            scan.drop_invalid(&config.range);
            integrator.integrate(&mut map, &scan)?;
            fusing += start.elapsed();
        }
        let start = Instant::now();
        integrator.finish(&mut map);
        fusing += start.elapsed();
        let look = RenderConfig {
            min_weight: config.mesh.min_weight,
            ..Default::default()
        };
        let renderer = Renderer::new(&map, &look)?;
        let mut collector = Collector::new(self.margin_m);
        for read in self.dataset.iter_indices(held_out) {
            let mut scan = read.scan?;
            scan.drop_invalid(&config.range);
            collector.add(&renderer, &scan);
        }
        Ok(Some(Score {
            name: form.name.clone(),
            voxel_size_m: config.map.voxel_size_m,
            truncation_m: config.map.truncation_m,
            secs_per_scan: fusing.as_secs_f64() / count as f64,
            held_out: collector.result().context("the held-out scans have no valid return")?,
            command: self.command(candidate),
        }))
    }

    fn command(&self, Candidate { form, config }: &Candidate) -> String {
        let mut settings = self.args.settings.clone();
        settings.voxel_size = Some(config.map.voxel_size_m);
        settings.truncation = Some(config.map.truncation_m);
        form.command(&settings)
    }
}

fn text(found: &Found) -> String {
    let mut text = format!(
        "{} of {} candidates tried in {:.0} s; the best on {} of {} scans, one of {} held out{}.\n\
         Objective: capped, the mean over all held-out returns of min(|Δr|, {} m), where false and missing surface\n\
         count as the most.\n\n",
        found.tried,
        found.candidates,
        found.secs,
        found.scans,
        found.all_scans,
        found.hold_out,
        if found.out_of_time { "; time was up" } else { "" },
        found.ranking[0].held_out.margin_m,
    );
    text += &format!(
        "  {:<22}{:>8}{:>8}{:>11}{:>8}{:>8}{:>9}{:>11}{:>9}\n",
        "", "voxel m", "trunc m", "capped mm", "hits", "false", "missing", "median mm", "scans/s"
    );
    for score in found.ranking.iter().take(SHOWN) {
        let held_out = &score.held_out;
        text += &format!(
            "  {:<22}{:>8}{:>8}{:>11.1}{:>8.3}{:>8.3}{:>9.3}{:>11.1}{:>9.1}\n",
            score.name,
            score.voxel_size_m,
            score.truncation_m,
            1e3 * held_out.capped_error_m,
            held_out.hit_rate,
            held_out.false_surface,
            held_out.missing,
            1e3 * held_out.error.map_or(f64::NAN, |error| error.median_m),
            1.0 / score.secs_per_scan,
        );
    }
    text + &format!("\n{}\n", found.ranking[0].command)
}
