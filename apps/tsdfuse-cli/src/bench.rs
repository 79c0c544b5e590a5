//! `tsdfuse bench`: what each stage takes on this machine, and how far that is from what its memory allows.

use std::path::Path;

use anyhow::Result;
use tsdfuse_evaluate::Form;
use tsdfuse_evaluate::bench::{
    Bench, Live, LiveResults, LongDrive, LongDriveResults, LongTrack, LongTrackResults, Results, STREET,
};
use tsdfuse_plan::EsdfConfig;
use tsdfuse_run::{Device, PosesFrom};

use crate::args::{LogArgs, Memory};
use crate::exit::{self, Outcome, Usage};
use crate::measuring::{Bars, told};
use crate::output::{command_line, print_results};

const EXAMPLES: &str = "\
A run is what `tsdfuse fuse` does, from files to a mesh in a temporary file. Threads that fuse and threads that read ahead share \
the cores. For comparison, the memory bandwidth with the same number of \
threads is measured just before.

Examples:
  tsdfuse bench
  tsdfuse bench pandaset/002 --methods raycast,raycast-projective,normals
  tsdfuse bench --threads 1 --json
  tsdfuse bench --long-drive 10000
  tsdfuse bench --long-drive 16000 --memory 512M
  tsdfuse bench --long-drive 20000 --poses track
  tsdfuse bench drive --live --scans 0..100
  tsdfuse bench --device gpu --methods raycast,patch";

/// Measure this machine: time of each stage, compared with the memory bandwidth.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, mut_arg("log", |log| log.required(false).default_value(STREET)
    .hide_default_value(true).help(format!("The log [default: {STREET}, the same everywhere]"))))]
pub(crate) struct Args {
    #[arg(long, visible_alias = "method", value_name = "NAMES", value_delimiter = ',',
        help = format!("Methods to measure: all, or some of {} [default: as with fuse]", Form::names().join(", ")))]
    methods: Vec<String>,
    /// Number of runs per method.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Print the results as JSON instead of tables.
    #[arg(long)]
    json: bool,
    /// Instead, drive N scans (VLP-16) through a repeating simulated street, and check whether scans take longer as the map
    /// grows. Voxels are 12.5 cm unless set otherwise. With --poses track: fly on and on through a simulated hall, and check whether it
    /// takes longer to place scans, and to recognise places, as the drive goes on.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(20..=1_000_000))]
    long_drive: Option<u32>,
    /// With --long-drive: limit the memory for blocks; then mesh the whole map and report the size of its file.
    #[arg(long, value_name = "SIZE", requires = "long_drive")]
    memory: Option<Memory>,
    /// Instead, do after each scan what a robot needs, and take the time: its pose (tracked where the log has none, or with --poses
    /// track), the map, the mesh of what changed, distances up to 2 m; beside these, which returns move.
    #[arg(long, conflicts_with_all = ["long_drive", "methods", "runs", "device"])]
    live: bool,
    /// With --live: what changes within so many metres of the sensor is told after each scan, what changes beyond in ten turns; inf: all after
    /// each.
    #[arg(long, value_name = "M", requires = "live", default_value_t = 30.0)]
    near: f64,
    /// Measure the CPU, or a GPU: fusing, meshing, rendering and each kernel.
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    device: Device,
    #[command(flatten)]
    log: LogArgs,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    if args.live {
        return live(args);
    }
    if args.long_drive.is_none() {
        args.log.check_poses_known()?;
    }
    let bench = args.bench()?;
    args.check(&bench.forms)?;
    args.log.set_threads()?;
    let mut bars = Bars::default();
    let watch = &mut |progress: tsdfuse_evaluate::Progress<'_>| bars.show(&progress);
    exit::quiet_gpu(&args.device);
    if let Device::Gpu(name) = &args.device {
        return gpu::run(&bench, name.as_deref(), args.json, watch);
    }
    if let (Some(scans), PosesFrom::Track) = (args.long_drive, args.log.poses_from()) {
        let track = LongTrack {
            scans: scans as usize,
            settings: bench.settings,
            command_line: bench.command_line,
        };
        let results = track.run(watch).map_err(told)?;
        print_results(&results, args.json, LongTrackResults::text)?;
        return Ok(Outcome::Complete);
    }
    if let Some(scans) = args.long_drive {
        let drive = LongDrive {
            form: bench.forms.into_iter().next(),
            settings: bench.settings,
            memory_bytes: args.memory.map(|memory| memory.0),
            folder: ".".into(),
            command_line: bench.command_line,
            ..LongDrive::of(scans as usize)
        };
        let results = drive.run(watch).map_err(told)?;
        print_results(&results, args.json, LongDriveResults::text)?;
        return Ok(Outcome::Complete);
    }
    let results = bench.run(watch).map_err(told)?;
    print_results(&results, args.json, Results::text)?;
    Ok(if results.is_complete() {
        Outcome::Complete
    } else {
        Outcome::ScansSkipped
    })
}

fn live(args: &Args) -> Result<Outcome> {
    let live = Live {
        input: args.log.input(),
        poses: args.log.poses_from(),
        settings: args.log.settings(None)?,
        esdf: EsdfConfig::default(),
        near_m: args.near,
        command_line: command_line(),
    };
    args.log.set_threads()?;
    let mut bars = Bars::default();
    let results = live.run(&mut |progress| bars.show(&progress)).map_err(told)?;
    print_results(&results, args.json, LiveResults::text)?;
    Ok(Outcome::Complete)
}

#[cfg(feature = "gpu")]
mod gpu {
    use anyhow::Result;
    use tsdfuse_evaluate::bench::{Bench, GpuResults, on_gpu};

    use crate::exit::Outcome;
    use crate::measuring::told;
    use crate::output::print_results;

    pub(super) fn run(
        bench: &Bench,
        name: Option<&str>,
        json: bool,
        watch: &mut tsdfuse_evaluate::Watch<'_>,
    ) -> Result<Outcome> {
        let results = on_gpu(bench, name, watch).map_err(told)?;
        print_results(&results, json, GpuResults::text)?;
        Ok(Outcome::Complete)
    }
}

#[cfg(not(feature = "gpu"))]
mod gpu {
    use anyhow::Result;
    use tsdfuse_evaluate::bench::Bench;

    use crate::exit::{Outcome, Usage};

    pub(super) fn run(_: &Bench, _: Option<&str>, _: bool, _: &mut tsdfuse_evaluate::Watch<'_>) -> Result<Outcome> {
        Err(Usage::new("this build does not support GPUs (built without the feature gpu)").into())
    }
}

impl Args {
    fn bench(&self) -> Result<Bench> {
        let forms = if self.methods.is_empty() {
            Vec::new()
        } else {
            Form::chosen(&self.methods, &[]).map_err(told)?
        };
        Ok(Bench {
            input: self.log.input(),
            settings: self.log.settings(None)?,
            forms,
            runs: self.runs as usize,
            command_line: command_line(),
        })
    }

    /// Finds out before the work what cannot be.
    fn check(&self, forms: &[Form]) -> Result<(), Usage> {
        if self.long_drive.is_none() {
            return Ok(());
        }
        if self.device != Device::Cpu {
            return Err(Usage::new("--long-drive is for the CPU"));
        }
        if forms.len() > 1 {
            return Err(Usage::new("--long-drive is for one method"));
        }
        if self.log.poses_from() != PosesFrom::Any && self.log.poses_from() != PosesFrom::Track {
            return Err(Usage::new(
                "--long-drive knows its poses, or tracks them: only --poses track goes with it",
            ));
        }
        if self.log.poses_from() == PosesFrom::Track && (!forms.is_empty() || self.memory.is_some()) {
            return Err(Usage::new(
                "--long-drive with --poses track makes no map: leave out --methods and --memory",
            ));
        }
        if self.log.log != Path::new(STREET) || self.log.scans.is_some() {
            return Err(Usage::new(
                "--long-drive simulates its own scans: no log and no --scans with it",
            ));
        }
        Ok(())
    }
}
