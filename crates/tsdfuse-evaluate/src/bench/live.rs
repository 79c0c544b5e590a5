//! How far a machine keeps up with a sensor: what a robot wants after each sweep, and how long it takes.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use tsdfuse::mesh::Nearby;
use tsdfuse_plan::{Esdf, EsdfConfig, Moving, MovingConfig};
use tsdfuse_run::report::ScanReport;
use tsdfuse_run::{
    Event, Input, Machine, Observer, Placing, PosesFrom, RunConfig, RunError, Session, Settings, Setup, cpu_secs,
};

use super::results::Data;
use super::street::{self, STREET};
use crate::error::{Error, Result};
use crate::progress::{Progress, Watch};

/// All that a planner needs after each sweep: its pose, the map, the surface that changed and the distances around it.
#[derive(Clone, Debug)]
pub struct Live {
    /// The log, or [`STREET`].
    pub input: Input,
    /// Where the poses come from. Those that nobody knows are tracked, without closing loops.
    pub poses: PosesFrom,
    /// What is set; the rest is the log's or the default.
    pub settings: Settings,
    /// The distances.
    pub esdf: EsdfConfig,
    /// What changes within so many metres of the sensor is told after each sweep, what changes beyond in ten turns ([`Nearby`]).
    pub near_m: f64,
    /// The arguments of the program, for the results.
    pub command_line: Vec<String>,
}

/// How long it took.
#[derive(Clone, Debug, Serialize)]
pub struct LiveResults {
    /// The version of this crate.
    pub version: &'static str,
    /// The arguments of the program as they were given, its name first.
    pub command_line: Vec<String>,
    /// This machine.
    pub machine: Machine,
    /// The log.
    pub dataset: Data,
    /// With what was fused.
    pub config: RunConfig,
    /// Voxels of the distances and how far they go, metres.
    pub distances_m: [f64; 2],
    /// What changed within so many metres of the sensor was told after each sweep; `None`: all.
    pub near_m: Option<f64>,
    /// Whether poses were tracked.
    pub tracked: bool,
    /// Each sweep.
    pub sweeps: Vec<Sweep>,
    /// From the first sweep to the last, without [`Sweep::moving`], which a planner may or may not want.
    pub seconds: f64,
    /// The processors' time of all threads by stage, seconds, where the system tells; other work on the machine changes it little.
    pub cpu: Option<Stages>,
}

/// Seconds by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Stages {
    /// Finding poses, reading the log, and what else is nowhere else.
    pub track: f64,
    /// Fusing.
    pub fuse: f64,
    /// Meshing what changed.
    pub mesh: f64,
    /// Distances around what changed.
    pub distances: f64,
    /// Telling which returns move; beside the others.
    pub moving: f64,
}

impl Stages {
    /// All that a planner waits for.
    pub fn in_all(&self) -> f64 {
        self.track + self.fuse + self.mesh + self.distances
    }
}

/// The processors' time since something else was timed.
#[derive(Debug)]
struct Processors {
    until: Option<f64>,
    stages: Stages,
}

impl Processors {
    /// Adds what was taken since the last call to a stage.
    fn spent(&mut self, stage: fn(&mut Stages) -> &mut f64) {
        let now = cpu_secs();
        if let (Some(now), Some(before)) = (now, self.until) {
            *stage(&mut self.stages) += now - before;
        }
        self.until = now;
    }
}

/// What was done after a sweep, in seconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Sweep {
    /// Returns that were measured.
    pub points: u64,
    /// Waiting for it to be read.
    pub wait: f64,
    /// Finding its pose, and what else is nowhere else.
    pub track: f64,
    /// Fusing it.
    pub fuse: f64,
    /// Meshing what changed.
    pub mesh: f64,
    /// Distances around what changed.
    pub distances: f64,
    /// Chunks of distances that were computed anew.
    pub chunks: usize,
    /// Telling which returns move; beside the others.
    pub moving: f64,
}

impl Sweep {
    /// All that a planner waits for.
    pub fn in_all(&self) -> f64 {
        self.track + self.fuse + self.mesh + self.distances
    }
}

/// Asks as a planner does, and takes the time.
struct Planner<'a, 'b> {
    watch: &'a mut Watch<'b>,
    esdf: Esdf,
    nearby: Nearby,
    moving: Moving,
    sweeps: Vec<Sweep>,
    /// Seconds of telling what moves, of the sweep that is being fused.
    moving_secs: f64,
    fused: Instant,
    processors: Processors,
    failed: Option<String>,
}

impl Observer for Planner<'_, '_> {
    fn on(&mut self, event: Event<'_>) {
        match event {
            Event::ScanRead { scan, .. } => {
                self.processors.spent(|stages| &mut stages.track);
                if let Some(pose) = scan.pose {
                    self.nearby.move_to(pose.translation);
                }
                let start = Instant::now();
                if let Err(error) = self.moving.classify(scan) {
                    self.failed = Some(error.to_string());
                }
                self.moving_secs = start.elapsed().as_secs_f64();
                self.processors.spent(|stages| &mut stages.moving);
            }
            Event::ScanFused {
                report: ScanReport { sums, .. },
                ..
            } => {
                self.processors.spent(|stages| &mut stages.fuse);
                self.fused = Instant::now();
                self.sweeps.push(Sweep {
                    points: sums.points,
                    wait: sums.wait,
                    fuse: sums.prepare + sums.fuse,
                    moving: self.moving_secs,
                    ..Sweep::default()
                });
            }
            Event::SurfaceChanged(changes) => {
                self.processors.spent(|stages| &mut stages.mesh);
                let meshed = Instant::now();
                let chunks = self.esdf.update_near(changes.iter(), &self.nearby).len();
                if let Some(sweep) = self.sweeps.last_mut() {
                    sweep.mesh += (meshed - self.fused).as_secs_f64();
                    sweep.distances += meshed.elapsed().as_secs_f64();
                    sweep.chunks += chunks;
                }
                self.processors.spent(|stages| &mut stages.distances);
                self.fused = Instant::now();
            }
            _ => {}
        }
        (self.watch)(Progress::Run(event));
    }
}

impl Live {
    /// Runs through the log as fast as it goes.
    ///
    /// # Errors
    /// [`Error::Config`] for options that do not fit together. If the log cannot be read or fused.
    pub fn run(&self, watch: &mut Watch<'_>) -> Result<LiveResults> {
        let wrong = |error: tsdfuse_plan::PlanError| Error::from(RunError::config(error));
        let mut input = self.input.clone();
        // Gone when all is done.
        let _simulated = match input.path == Path::new(STREET) {
            true => {
                let folder = street::write(watch)?;
                input.path = folder.path().to_owned();
                Some(folder)
            }
            false => None,
        };
        let mut planner = Planner {
            watch,
            esdf: Esdf::new(self.esdf).map_err(wrong)?,
            nearby: Nearby::new(self.near_m),
            moving: Moving::new(MovingConfig::default()).map_err(wrong)?,
            sweeps: Vec::new(),
            moving_secs: 0.0,
            fused: Instant::now(),
            processors: Processors {
                until: None,
                stages: Stages::default(),
            },
            failed: None,
        };
        let log = input.open_unplaced(&self.settings, &mut planner)?;
        let mut config = self.settings.resolve(&log)?;
        // That is told apart here, and timed by itself.
        config.moving.leave_out = Some(false);
        let tracked = match self.poses {
            PosesFrom::Track => true,
            PosesFrom::Any => log.is_unplaced(),
            PosesFrom::Log => false,
            PosesFrom::Refine => {
                let told = "poses are refined when all sweeps are known, not sweep by sweep";
                return Err(RunError::config(told).into());
            }
        };
        let setup = Setup {
            config: config.clone(),
            placing: if tracked { Placing::Track } else { Placing::Given },
            loops: false,
            selection: input.selection.clone(),
            skip_bad: input.skip_bad,
            follow_every: Some(1),
            follow_near_m: Some(self.near_m),
            ..Setup::default()
        };
        let mut session = Session::begin(&log, setup, &mut planner)?;
        planner.processors.until = cpu_secs();
        let (mut seconds, mut before) = (0.0, 0);
        loop {
            let start = Instant::now();
            let goes_on = session.step(&mut planner)?;
            let step = start.elapsed().as_secs_f64();
            let new = planner.sweeps.get_mut(before..).unwrap_or_default();
            let told: f64 = new.iter().map(|sweep| sweep.fuse + sweep.mesh + sweep.distances).sum();
            let moving: f64 = new.iter().map(|sweep| sweep.moving).sum();
            let wait: f64 = new.iter().map(|sweep| sweep.wait).sum();
            seconds += step - moving;
            // Of a step that places several, or none, each has its share; the first sweep is placed with the second.
            let rest = (step - told - moving - wait).max(0.0) / new.len().max(1) as f64;
            new.iter_mut().for_each(|sweep| sweep.track = rest);
            before = planner.sweeps.len();
            if !goes_on {
                break;
            }
        }
        if let Some(reason) = planner.failed {
            return Err(Error::Failed(reason));
        }
        if planner.sweeps.is_empty() {
            return Err(RunError::Nothing(format!("{}: no scan was fused", self.input.path.display())).into());
        }
        Ok(LiveResults {
            version: env!("CARGO_PKG_VERSION"),
            command_line: self.command_line.clone(),
            machine: Machine::here(rayon::current_num_threads()),
            dataset: Data {
                name: self.input.path.display().to_string(),
                format: log.format().to_owned(),
                scans: planner.sweeps.len(),
            },
            config,
            distances_m: [self.esdf.voxel_size_m, self.esdf.radius_m],
            near_m: Some(self.near_m).filter(|near_m| near_m.is_finite()),
            tracked,
            sweeps: planner.sweeps,
            seconds,
            cpu: planner.processors.until.map(|_| planner.processors.stages),
        })
    }
}

/// What is told, row by row.
type Row = (&'static str, fn(&Sweep) -> f64, fn(&Stages) -> f64);

impl LiveResults {
    /// How many sweeps a second this machine keeps up with.
    pub fn sweeps_per_sec(&self) -> f64 {
        self.sweeps.len() as f64 / self.seconds
    }

    /// All figures.
    pub fn text(&self) -> String {
        let Self {
            machine,
            dataset,
            config,
            sweeps,
            cpu,
            ..
        } = self;
        let points = sweeps.iter().map(|sweep| sweep.points).sum::<u64>() / sweeps.len().max(1) as u64;
        let mut text = format!(
            "{}, {} thread{}, {}, {}\n{}: {} sweeps of {points} points, {}, voxels of {} m\n\n{:<24} {:>8} {:>8} {:>8} {:>8} {:>9}\n",
            machine.processor.as_deref().unwrap_or(&machine.system),
            machine.threads,
            if machine.threads == 1 { "" } else { "s" },
            machine.simd,
            machine.date,
            dataset.name,
            sweeps.len(),
            config.method.name(),
            config.map.voxel_size_m,
            "ms a sweep",
            "mean",
            "median",
            "95 %",
            "most",
            if cpu.is_some() { "CPU mean" } else { "" },
        );
        let rows: [Row; 6] = [
            (
                if self.tracked { "pose" } else { "placing" },
                |sweep| sweep.track,
                |cpu| cpu.track,
            ),
            ("map", |sweep| sweep.fuse, |cpu| cpu.fuse),
            ("mesh of what changed", |sweep| sweep.mesh, |cpu| cpu.mesh),
            ("distances", |sweep| sweep.distances, |cpu| cpu.distances),
            ("in all", Sweep::in_all, Stages::in_all),
            ("which returns move", |sweep| sweep.moving, |cpu| cpu.moving),
        ];
        let per_sweep_ms = 1e3 / sweeps.len().max(1) as f64;
        for (name, of, cpu_of) in rows {
            let mut ms: Vec<f64> = sweeps.iter().map(|sweep| 1e3 * of(sweep)).collect();
            ms.sort_unstable_by(f64::total_cmp);
            let at = |share: f64| ms[((ms.len() - 1) as f64 * share).round() as usize];
            let mean = ms.iter().sum::<f64>() / ms.len() as f64;
            let [median, most_of_them, most] = [0.5, 0.95, 1.0].map(at);
            text += &format!("  {name:<22} {mean:>8.1} {median:>8.1} {most_of_them:>8.1} {most:>8.1}");
            let cpu = cpu.as_ref().map(|cpu| format!(" {:>9.1}", per_sweep_ms * cpu_of(cpu)));
            text += &cpu.unwrap_or_default();
            text.push('\n');
        }
        let late = sweeps.iter().filter(|sweep| sweep.in_all() > 0.1).count();
        let distances: f64 = sweeps.iter().map(|sweep| sweep.distances).sum();
        let [voxel, radius] = self.distances_m;
        let near = self
            .near_m
            .map(|near_m| format!("what changed beyond {near_m} m is told in ten turns\n"));
        let near = near.unwrap_or_default();
        let cores = cpu.map(|cpu| {
            let cores = 10.0 * cpu.in_all() / sweeps.len() as f64;
            format!("at 10 sweeps/s, that is the work of {cores:.1} cores\n")
        });
        text + &format!(
            "\n{:.1} sweeps/s with all but the last row; {late} of {} took longer than 100 ms\n\
             distances in voxels of {voxel} m up to {radius} m: {:.1} updates/s\n{near}",
            self.sweeps_per_sec(),
            sweeps.len(),
            sweeps.len() as f64 / distances,
        ) + &cores.unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse_io::Selection;

    #[test]
    fn a_street_is_planned_in_sweep_by_sweep() {
        let mut settings = Settings::default();
        for (key, value) in [("map.voxel_size_m", 0.2), ("map.truncation_m", 0.6)] {
            settings.set("test", key, value).unwrap();
        }
        let live = |poses| Live {
            input: Input {
                path: STREET.into(),
                selection: "0..4".parse::<Selection>().unwrap(),
                ..Input::default()
            },
            poses,
            settings: settings.clone(),
            esdf: EsdfConfig {
                voxel_size_m: 0.4,
                radius_m: 1.2,
            },
            near_m: 10.0,
            command_line: Vec::new(),
        };
        for (poses, row) in [(PosesFrom::Any, "placing"), (PosesFrom::Track, "pose")] {
            let results = live(poses).run(&mut |_| {}).unwrap();
            assert_eq!(results.sweeps.len(), 4);
            for sweep in &results.sweeps {
                assert!(sweep.chunks > 10 && sweep.points > 10_000, "{sweep:?}");
                assert!(
                    sweep.fuse > 0.0 && sweep.mesh > 0.0 && sweep.distances > 0.0,
                    "{sweep:?}"
                );
            }
            let sum: f64 = results.sweeps.iter().map(Sweep::in_all).sum();
            assert!(
                results.seconds > 0.0 && sum <= results.seconds * 1.001,
                "{sum} {}",
                results.seconds
            );
            let text = results.text();
            assert!(text.contains(row) && text.contains("updates/s"), "{text}");
        }
        let told = live(PosesFrom::Refine).run(&mut |_| {}).unwrap_err().to_string();
        assert!(told.contains("refined"), "{told}");
    }
}
