//! Tables of what other sensors measured: after a header, a time and numbers in each line.

use std::path::Path;

use crate::error::Result;
use crate::text::{self, Line};

/// A line that was read.
pub(super) struct Row<'a, const N: usize> {
    pub(super) time_ns: i64,
    /// All columns, the time (seconds) first; finite.
    pub(super) numbers: [f64; N],
    /// For messages.
    pub(super) line: Line<'a>,
}

/// Parses a table with these columns, the time first, which must ascend. `what` is what a line holds, and `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub(super) fn parse<T, const N: usize>(
    path: &Path,
    bytes: &[u8],
    columns: &[&str; N],
    what: &str,
    of: impl Fn(&Row<'_, N>) -> Result<T>,
) -> Result<Vec<T>> {
    let mut lines = text::lines(path, bytes)?;
    match lines.next() {
        Some(header) if !header.words().eq(*columns) => {
            return Err(header.error(format!("the header is not {}", columns.join(","))));
        }
        _ => {}
    }
    let (mut samples, mut last_ns) = (Vec::new(), None);
    for line in lines {
        let numbers = <[f64; N]>::try_from(line.numbers()?)
            .map_err(|numbers| line.error(format!("{} numbers where a {what} has {N}", numbers.len())))?;
        if let Some((name, _)) = columns.iter().zip(&numbers).find(|(_, number)| !number.is_finite()) {
            return Err(line.error(format!("{name} is not finite")));
        }
        // From the text itself, as the times of scans.
        let time_ns = line.words().next().and_then(text::nanoseconds);
        let time_ns = time_ns.ok_or_else(|| line.error("the time is too large"))?;
        let row = Row { time_ns, numbers, line };
        samples.push(of(&row)?);
        if last_ns.is_some_and(|last| last >= time_ns) {
            return Err(row
                .line
                .error(format!("the time is not later than that of the {what} before")));
        }
        last_ns = Some(time_ns);
    }
    Ok(samples)
}
