//! This program: what it was called with, and how it is started again.

use std::ffi::OsString;
use std::io;
use std::process::Command;
use std::sync::{PoisonError, RwLock};

/// How the program was called.
#[derive(Clone, Debug, Default)]
struct Called {
    /// The file of the program, and what follows it before the arguments: `python -m tsdfuse`. Empty: this process's own file.
    start: Vec<OsString>,
    /// The name of the program and its arguments.
    arguments: Vec<OsString>,
}

static CALLED: RwLock<Called> = RwLock::new(Called {
    start: Vec::new(),
    arguments: Vec::new(),
});

/// Says how the program was called, before anything else is done.
pub(crate) fn set(start: Vec<OsString>, arguments: Vec<OsString>) {
    *CALLED.write().unwrap_or_else(PoisonError::into_inner) = Called { start, arguments };
}

fn called() -> Called {
    CALLED.read().unwrap_or_else(PoisonError::into_inner).clone()
}

/// The arguments as they were given, the program's name first.
pub(crate) fn command_line() -> Vec<String> {
    let arguments = called().arguments;
    arguments.iter().map(|a| a.to_string_lossy().into_owned()).collect()
}

/// The arguments without the program's name.
#[cfg(all(unix, feature = "gpu"))]
pub(crate) fn arguments() -> Vec<OsString> {
    called().arguments.into_iter().skip(1).collect()
}

/// Starts this program, without arguments so far.
pub(crate) fn again() -> io::Result<Command> {
    let mut start = called().start.into_iter();
    let program = match start.next() {
        Some(program) => program,
        None => std::env::current_exe()?.into_os_string(),
    };
    let mut command = Command::new(program);
    command.args(start);
    Ok(command)
}
