//! What people see while they wait: bars on a terminal, which vanish when dropped, and nothing in a pipe. All of it goes to standard error.

use std::borrow::Cow;
use std::fmt::{Arguments, Display};
use std::io::Write;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};

/// Writes a line to standard error; if that is closed, nobody is there to be told.
pub(crate) fn say(line: Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Writes a line about something odd.
pub(crate) fn note(sentence: impl Display) {
    say(format_args!("tsdfuse: note: {sentence}"));
}

/// A bar of `len` scans, or a count where nobody knows how many there will be.
pub(crate) fn scans(doing: &'static str, len: Option<usize>) -> ProgressBar {
    match len {
        Some(len) => styled(
            ProgressBar::new(len as u64),
            doing,
            "{msg} {wide_bar} {pos}/{len} scans, {per_sec}, {eta} left",
        ),
        None => styled(
            ProgressBar::new_spinner(),
            doing,
            "{spinner} {msg} {pos} scans, {per_sec}",
        ),
    }
}

/// A bar of `len` parts of a longer work, which it names.
pub(crate) fn steps(doing: &'static str, len: usize) -> ProgressBar {
    styled(
        ProgressBar::new(len as u64),
        doing,
        "{msg} {wide_bar} {pos}/{len}, {elapsed}",
    )
}

/// A sign of life for work of unknown length.
pub(crate) fn working(doing: impl Into<Cow<'static, str>>) -> ProgressBar {
    let bar = styled(ProgressBar::new_spinner(), doing, "{spinner} {msg} {elapsed}");
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

fn styled(bar: ProgressBar, doing: impl Into<Cow<'static, str>>, template: &str) -> ProgressBar {
    // The default style where the template is not understood.
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style)
        .with_message(doing)
        .with_finish(ProgressFinish::AndClear)
}
