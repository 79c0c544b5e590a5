//! What a measurement tells those who wait for it.

use tsdfuse_run::{Event, Observer};

/// What a measurement tells those who wait for it, through a closure.
#[derive(Debug)]
#[non_exhaustive]
pub enum Progress<'a> {
    /// Work begins, such as `evaluating`; it ends with [`Self::Done`].
    Begun {
        /// What is done.
        work: &'static str,
        /// Its steps; not known of some work.
        steps: Option<usize>,
    },
    /// A step begins, and this is what it is about.
    At(&'a str),
    /// A step is done.
    Step,
    /// The work is done.
    Done,
    /// A sentence about something unusual.
    Note(&'a str),
    /// An event of a run that belongs to the measurement.
    Run(Event<'a>),
}

/// Whoever waits: ignore what is told with `&mut |_| {}`.
pub type Watch<'a> = dyn FnMut(Progress<'_>) + 'a;

/// Passes on the events of runs.
pub(crate) struct Runs<'a, 'b>(pub(crate) &'a mut Watch<'b>);

impl Observer for Runs<'_, '_> {
    fn on(&mut self, event: Event<'_>) {
        (self.0)(Progress::Run(event));
    }
}
