//! `tsdfuse run-job`, hidden: runs one job in a process of its own, so that its memory is its own. The job comes from standard
//! input as JSON, and its report, or why there is none, goes to standard output.

use std::process::Stdio;

use anyhow::{Context, Result, bail};
use tsdfuse_run::{Job, Report, Silent, Stop};

use crate::exit::{Outcome, one_line};
use crate::output::print_json;
use crate::program;

pub(crate) fn run() -> Result<Outcome> {
    let job: Job = serde_json::from_reader(std::io::stdin().lock()).context("standard input is not a job")?;
    let report = job.run(&Stop::default(), &mut Silent);
    print_json(&report.map_err(|error| error.to_string()))?;
    Ok(Outcome::Complete)
}

/// Runs jobs with this program, each in a process of its own.
pub(crate) fn in_own_process(threads: Option<u16>) -> impl FnMut(&Job) -> Result<Report, String> {
    move |job| start(job, threads).unwrap_or_else(|error| Err(one_line(&error)))
}

fn start(job: &Job, threads: Option<u16>) -> Result<Result<Report, String>> {
    let mut command = program::again().context("this program's own file")?;
    command.arg("run-job");
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    if let Some(threads) = threads {
        command.env("RAYON_NUM_THREADS", threads.to_string());
    }
    let mut process = command.spawn().context("tsdfuse run-job")?;
    if let Some(stdin) = process.stdin.take() {
        // It reads all of the job before it writes anything. If it died, its output tells.
        let _ = serde_json::to_writer(stdin, job);
    }
    let done = process.wait_with_output().context("tsdfuse run-job")?;
    if !done.status.success() {
        let told = String::from_utf8_lossy(&done.stderr);
        bail!(
            "its process ended with {}: {}",
            done.status,
            told.lines().last().unwrap_or("it said nothing")
        );
    }
    serde_json::from_slice(&done.stdout).context("the output of tsdfuse run-job")
}
