//! Which method, voxel size and truncation predict held-out scans best.
//!
//! A coarse grid on few scans, then successive halving (Jamieson and Talwalkar, AISTATS 2016): the best quarter on twice as
//! many scans, until one candidate is left, all scans are used, or time is up. The objective counts missing and false surface
//! as much as the largest error, so that leaving holes does not pay.

use std::time::{Duration, Instant};

use tsdfuse_io::{Log, Selection};
use tsdfuse_run::report::SkippedScan;
use tsdfuse_run::{Job, Outputs, RunConfig, Session, Setup, Silent};

use crate::command;
use crate::contest::Contest;
use crate::error::{Error, Result};
use crate::form::Form;
use crate::held_out::{self, HeldOutScans};
use crate::progress::{Progress, Runs, Watch};
use crate::reference;
use crate::tuned::{Score, Tuned};

/// Voxel sizes that are tried, as multiples of the default.
const VOXELS: [f64; 4] = [1.0, 1.6, 0.6, 2.4];

/// Truncations that are tried, in voxels.
const TRUNCATIONS: [f64; 3] = [4.0, 3.0, 6.0];

/// One of so many is kept after each round.
const KEPT: usize = 4;

/// One of so many scans is held out, unless that is asked for otherwise.
const HOLD_OUT: usize = 5;

/// A search for the best method, voxel size and truncation.
#[derive(Clone, Debug)]
pub struct Tuning {
    /// The methods and the data. One of 5 scans is held out, unless that is set, at least every second; or fewer where there
    /// are fewer scans.
    pub contest: Contest,
    /// Time limit of the search, seconds.
    pub budget_secs: f64,
}

/// What is tried.
#[derive(Clone, Debug)]
struct Candidate {
    form: Form,
    config: RunConfig,
}

impl Tuning {
    /// A search of five minutes.
    pub fn of(contest: Contest) -> Self {
        Self {
            contest,
            budget_secs: 300.0,
        }
    }

    /// Searches.
    ///
    /// # Errors
    /// [`Error::Config`] before any work for options that do not fit together. If no method can be used, or time is up before
    /// anything was measured.
    pub fn run(&self, watch: &mut Watch<'_>) -> Result<Tuned> {
        let contest = &self.contest;
        contest.check()?;
        let log = contest.input.open(&contest.settings, &mut Runs(watch))?;
        let scans = reference::length(&log)?;
        let selection = held_out::selection(&contest.input.selection, contest.hold_out, HOLD_OUT, scans)?;
        let Some(hold_out) = selection.hold_out else {
            return Err(Error::config("--tune needs held-out scans: --hold-out 2 or more"));
        };
        let mut search = Search {
            asked: self,
            log: &log,
            hold_out,
            all_scans: contest.input.selection.indices(scans).len(),
            margin_m: contest.margin_m(&log),
            start: Instant::now(),
            budget: Duration::try_from_secs_f64(self.budget_secs).ok(),
            skipped: Vec::new(),
        };
        let found = search.run(search.candidates()?, watch)?;
        Ok(Tuned {
            skipped_scans: search.skipped,
            ..found
        })
    }
}

struct Search<'a> {
    asked: &'a Tuning,
    log: &'a Log,
    hold_out: usize,
    all_scans: usize,
    margin_m: f64,
    start: Instant,
    /// None: forever.
    budget: Option<Duration>,
    skipped: Vec<SkippedScan>,
}

impl Search<'_> {
    /// Each form with each voxel size and truncation that are not set; the defaults of all forms first.
    fn candidates(&self) -> Result<Vec<Candidate>> {
        let forms = &self.asked.contest.forms;
        let config = |form: &Form, voxel: f64, truncation: f64| {
            let settings = form.over(&self.asked.contest.settings)?;
            let [voxel_is_set, truncation_is_set] =
                ["voxel_size_m", "truncation_m"].map(|key| settings.has("map", key));
            let mut config = settings.resolve(self.log)?;
            let millimetres = |length_m: f64| (length_m * 1e3).round() / 1e3;
            if !voxel_is_set {
                config.map.voxel_size_m = millimetres(config.map.voxel_size_m * voxel);
            }
            if !truncation_is_set {
                config.map.truncation_m = millimetres(config.map.voxel_size_m * truncation);
            }
            Ok::<_, Error>(config)
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

    fn run(&mut self, mut candidates: Vec<Candidate>, watch: &mut Watch<'_>) -> Result<Tuned> {
        let count = candidates.len();
        let mut scans = (2 * self.hold_out).min(self.all_scans);
        let mut found: Option<Tuned> = None;
        loop {
            let (mut scored, out_of_time) = self.round(&candidates, scans, watch)?;
            // Only candidates of one round are comparable; the first round counts as far as it came.
            if let (true, Some(found)) = (out_of_time, &found) {
                return Ok(Tuned {
                    out_of_time,
                    secs: self.start.elapsed().as_secs_f64(),
                    ..found.clone()
                });
            }
            let error = |(_, score): &(Candidate, Score)| score.held_out.capped_error_m;
            scored.sort_by(|a, b| error(a).total_cmp(&error(b)));
            if scored.is_empty() {
                return Err(Error::Failed(if out_of_time {
                    let budget = self.asked.budget_secs;
                    format!("time ran out before anything was measured: increase --budget {budget}")
                } else {
                    "no method could be run".to_owned()
                }));
            }
            let round = Tuned {
                scans,
                all_scans: self.all_scans,
                hold_out: self.hold_out,
                candidates: count,
                tried: found.map_or(scored.len(), |found| found.tried),
                out_of_time,
                secs: self.start.elapsed().as_secs_f64(),
                ranking: scored.iter().map(|(_, score)| score.clone()).collect(),
                skipped_scans: Vec::new(),
            };
            if out_of_time || scans == self.all_scans || scored.len() == 1 {
                return Ok(round);
            }
            found = Some(round);
            let kept = scored.len().div_ceil(KEPT);
            candidates = scored.into_iter().take(kept).map(|(candidate, _)| candidate).collect();
            scans = (2 * scans).min(self.all_scans);
        }
    }

    /// The scores of all candidates that can be used, as far as time allows, and whether time was up.
    fn round(
        &mut self,
        candidates: &[Candidate],
        scans: usize,
        watch: &mut Watch<'_>,
    ) -> Result<(Vec<(Candidate, Score)>, bool)> {
        watch(Progress::Begun {
            work: "tuning",
            steps: Some(candidates.len()),
        });
        let (mut scored, mut failed) = (Vec::new(), Vec::new());
        let mut out_of_time = false;
        for candidate in candidates {
            let Candidate { form, config } = candidate;
            watch(Progress::At(&format!(
                "{scans} scans: {}, {} m",
                form.name, config.map.voxel_size_m
            )));
            if !failed.contains(&form) {
                match self.score(candidate, scans) {
                    Ok(Some(score)) => scored.push((candidate.clone(), score)),
                    Ok(None) => {
                        out_of_time = true;
                        break;
                    }
                    Err(error) => {
                        watch(Progress::Note(&format!("{}: {error}", form.name)));
                        failed.push(form);
                    }
                }
            }
            watch(Progress::Step);
        }
        watch(Progress::Done);
        Ok((scored, out_of_time))
    }

    fn is_out_of_time(&self) -> bool {
        self.budget.is_some_and(|budget| self.start.elapsed() >= budget)
    }

    /// So many scans from the middle, some of them held out.
    fn middle(&self, scans: usize) -> Selection {
        let Selection { from, step, .. } = self.asked.contest.input.selection;
        let first = from + (self.all_scans - scans) / 2 * step;
        Selection {
            from: first,
            to: Some(first + (scans - 1) * step + 1),
            step,
            hold_out: Some(self.hold_out),
        }
    }

    /// Fuses scans without the held-out ones, and looks at these; `None` when time is up.
    fn score(&mut self, candidate: &Candidate, scans: usize) -> Result<Option<Score>> {
        let Candidate { form, config } = candidate;
        let (selection, skip_bad) = (self.middle(scans), self.asked.contest.input.skip_bad);
        let setup = Setup {
            config: config.clone(),
            selection: selection.clone(),
            skip_bad,
            ..Setup::default()
        };
        let mut session = Session::begin(self.log, setup, &mut Silent)?;
        loop {
            if self.is_out_of_time() {
                return Ok(None);
            }
            if !session.step(&mut Silent)? {
                break;
            }
        }
        session.finish(&mut Silent)?;
        let map = session.map().ok_or_else(|| Error::failed("the map is not in memory"))?;
        let length = reference::length(self.log)?;
        let held_out = HeldOutScans::of(&selection, length, self.margin_m, skip_bad);
        let (collector, not_seen) = held_out.measure(self.log, map, config)?;
        for skipped in session.skipped().iter().chain(&not_seen) {
            if !self.skipped.iter().any(|known| known.name == skipped.name) {
                self.skipped.push(skipped.clone());
            }
        }
        let (totals, command) = (session.totals(), self.command(candidate)?);
        let fusing = totals.sums.prepare + totals.sums.fuse + totals.finish.seconds;
        Ok(collector.result().map(|held_out| Score {
            name: form.name.clone(),
            voxel_size_m: config.map.voxel_size_m,
            truncation_m: config.map.truncation_m,
            secs_per_scan: fusing / totals.scans.max(1) as f64,
            held_out,
            command,
        }))
    }

    fn command(&self, Candidate { form, config }: &Candidate) -> Result<String> {
        let mut settings = form.over(&self.asked.contest.settings)?;
        settings.set("--voxel-size", "map.voxel_size_m", config.map.voxel_size_m)?;
        settings.set("--truncation", "map.truncation_m", config.map.truncation_m)?;
        Ok(command::of(&Job {
            input: self.asked.contest.input.clone(),
            settings,
            outputs: Outputs {
                mesh: Some("mesh.ply".into()),
                ..Outputs::default()
            },
            ..Job::default()
        }))
    }
}
