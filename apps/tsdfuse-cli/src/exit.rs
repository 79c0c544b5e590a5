//! How a run ends: exit codes, and errors as one line.

use std::fmt::{self, Display};
use std::io;

use anyhow::Result;
use tsdfuse_run::{Device, RunError, Stop};

#[cfg(all(unix, feature = "gpu"))]
use crate::program;
use crate::progress::say;

/// What the exit codes mean, for `--help`.
pub(crate) const CODES: &str = "\
Exit codes: 0 complete, 1 failed, 2 wrong command line or configuration, 3 finished, but incomplete: scans were skipped or blocks lost, as the messages say.";

/// How a run that did not fail ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outcome {
    /// Nothing is missing.
    Complete,
    /// Some scans are not in the result: they could not be used and were named, or the run was stopped.
    ScansSkipped,
    /// Some blocks of a damaged map could not be recovered; what was damaged was named.
    BlocksLost,
}

/// The command line or the configuration asks for what cannot be.
#[derive(Debug)]
pub(crate) struct Usage(String);

impl Usage {
    /// Says what is wrong.
    pub(crate) fn new(what: impl Display) -> Self {
        Self(what.to_string())
    }
}

impl Display for Usage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Reports what went wrong, if anything did, and gives the exit code.
pub(crate) fn code(result: anyhow::Result<Outcome>) -> u8 {
    match result {
        Ok(Outcome::Complete) => 0,
        Ok(Outcome::ScansSkipped | Outcome::BlocksLost) => 3,
        // Who closed the pipe knows.
        Err(error) if is_broken_pipe(&error) => 1,
        Err(error) => {
            say(format_args!("tsdfuse: error: {}", one_line(&error)));
            let is_usage = error.is::<Usage>() || matches!(error.downcast_ref(), Some(RunError::Config(_)));
            if is_usage { 2 } else { 1 }
        }
    }
}

/// What Ctrl-C stops, between two scans; a second one ends the program at once.
pub(crate) fn stop_on_interrupt() -> Result<Stop> {
    let stop = Stop::default();
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGINT, SIGTERM};
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register_conditional_shutdown(signal, 130, stop.flag())?;
            signal_hook::flag::register(signal, stop.flag())?;
        }
    }
    Ok(stop)
}

/// Lets a file that must not grow any more be an error of writing, instead of the end of the program.
pub(crate) fn ignore_file_size_signal() {
    #[cfg(unix)]
    {
        // If the system refuses, the program ends as it did before.
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Stop::default().flag());
    }
}

/// Before a GPU is opened: Mesa's drivers print lines of their own unless a variable is set, which only a new start of the
/// program can do. It replaces this one.
pub(crate) fn quiet_gpu(device: &Device) {
    #[cfg(all(unix, feature = "gpu"))]
    if let (Device::Gpu(_), Some((name, value))) = (device, tsdfuse_gpu::quiet_variable()) {
        use std::os::unix::process::CommandExt;
        if let Ok(mut command) = program::again() {
            // It returns only if it fails; then there are some lines more.
            let _ = command.args(program::arguments()).env(name, value).exec();
        }
    }
    let _ = device;
}

/// Prints the help or version that was asked for, or says in one line what is wrong with the arguments.
pub(crate) fn not_parsed(error: &clap::Error) -> u8 {
    use clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
    if !error.use_stderr() || error.kind() == DisplayHelpOnMissingArgumentOrSubcommand {
        let code = if error.use_stderr() { 2 } else { 0 };
        // A closed pipe is nobody's mistake.
        let _ = error.print();
        return code;
    }
    let text = error.render().to_string();
    let told = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with("Usage:") && !line.starts_with("For more information"));
    let told: Vec<_> = told.collect();
    say(format_args!("tsdfuse: {}", told.join(" ")));
    2
}

/// An error and its causes.
pub(crate) fn one_line(error: &anyhow::Error) -> String {
    let causes: Vec<_> = error.chain().map(ToString::to_string).collect();
    causes.join(": ").replace('\n', " ")
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let is = |error: &io::Error| error.kind() == io::ErrorKind::BrokenPipe;
    let of_io = |error: &tsdfuse_io::Error| matches!(error, tsdfuse_io::Error::Io { reason, .. } if is(reason));
    error.chain().any(|cause| {
        let by_run = matches!(cause.downcast_ref(), Some(RunError::Io(error)) if of_io(error));
        by_run || cause.downcast_ref().is_some_and(of_io) || cause.downcast_ref().is_some_and(is)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn causes_are_told_once_and_in_one_line() {
        let io = tsdfuse_io::Error::io("a.bin")(io::Error::other("disk\nfull"));
        let error = Err::<(), _>(io).context("scan 3").unwrap_err();
        assert_eq!(one_line(&error), "scan 3: a.bin: disk full");
    }
}
