//! What `evaluate`, `bench` and `eval` share: progress as bars, errors as exit codes.

use indicatif::ProgressBar;
use tsdfuse_evaluate::{Error, Progress};
use tsdfuse_run::Observer;

use crate::exit::Usage;
use crate::progress::{self, note};
use crate::terminal::Terminal;

/// Shows the progress of a measurement.
#[derive(Default)]
pub(crate) struct Bars {
    bar: Option<ProgressBar>,
    /// Shows the runs that belong to it.
    terminal: Terminal,
}

impl Bars {
    pub(crate) fn show(&mut self, progress: &Progress<'_>) {
        match *progress {
            Progress::Begun { work, steps } => {
                self.bar = Some(match steps {
                    Some(steps) => progress::steps(work, steps),
                    None => progress::working(work),
                });
            }
            Progress::At(step) => self.bar.iter().for_each(|bar| bar.set_message(step.to_owned())),
            Progress::Step => self.bar.iter().for_each(|bar| bar.inc(1)),
            Progress::Done => self.bar = None,
            Progress::Note(sentence) => match &self.bar {
                Some(bar) => bar.suspend(|| note(sentence)),
                None => note(sentence),
            },
            Progress::Run(event) => self.terminal.on(event),
            _ => {}
        }
    }
}

/// An error with what its exit code depends on.
pub(crate) fn told(error: Error) -> anyhow::Error {
    match error {
        Error::Config(reason) => Usage::new(reason).into(),
        error => error.into(),
    }
}
