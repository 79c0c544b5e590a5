//! The `tsdfuse` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(tsdfuse_cli::run(Vec::new(), std::env::args_os().collect()))
}
