//! What goes to standard output, for other programs.

use std::io::{IsTerminal, Write};
use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;

use crate::exit::Usage;
pub(crate) use crate::program::command_line;

/// Checks that a mesh for standard output (`-`) does not meet a report or a terminal there.
pub(crate) fn check_terminal(mesh: &Path, json: bool) -> Result<(), Usage> {
    if mesh.as_os_str() != "-" {
        return Ok(());
    }
    if json {
        return Err(Usage::new("--output - and --json cannot both have standard output"));
    }
    if std::io::stdout().is_terminal() {
        return Err(Usage::new("--output - would write a binary file to the terminal"));
    }
    Ok(())
}

/// Prints a value as JSON on standard output.
pub(crate) fn print_json(value: &impl Serialize) -> Result<()> {
    print(&(serde_json::to_string_pretty(value)? + "\n"))
}

/// Prints results, for programs or for people.
pub(crate) fn print_results<T: Serialize>(results: &T, json: bool, text: impl FnOnce(&T) -> String) -> Result<()> {
    if json {
        print_json(results)
    } else {
        print(&text(results))
    }
}

/// Prints text on standard output.
pub(crate) fn print(text: &str) -> Result<()> {
    std::io::stdout().write_all(text.as_bytes()).context("standard output")
}
