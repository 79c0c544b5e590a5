//! The `tsdfuse` command: LiDAR log in, surface out. It translates; the work is done by the libraries.
//!
//! The program is [`run`] and nothing else, so that a Python module can carry the command, too.

mod args;
mod bench;
mod convert;
mod eval;
mod evaluate;
mod exit;
mod fuse;
mod info;
mod map;
mod measuring;
mod mesh;
mod odometry;
mod output;
mod poses;
mod program;
mod progress;
mod render;
mod resume;
mod run_job;
#[cfg(feature = "serve")]
mod serve;
#[cfg(any(feature = "serve", feature = "view"))]
mod serving;
mod simulate;
mod terminal;
mod user;
#[cfg(feature = "view")]
mod view;

use std::ffi::OsString;

use clap::{Parser, Subcommand};

/// Dense 3D reconstruction from LiDAR: scans with poses in, a surface out.
#[derive(Debug, Parser)]
#[command(name = "tsdfuse", version, after_help = exit::CODES, arg_required_else_help = true, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Fuse(Box<fuse::Args>),
    Map(map::Args),
    Mesh(mesh::Args),
    Resume(resume::Args),
    Render(Box<render::Args>),
    #[cfg(feature = "view")]
    View(view::Args),
    #[cfg(feature = "serve")]
    Serve(Box<serve::Args>),
    Simulate(simulate::Args),
    Info(info::Args),
    Convert(convert::Args),
    Eval(eval::Args),
    Odometry(odometry::Args),
    Poses(poses::Args),
    Evaluate(Box<evaluate::Args>),
    Bench(Box<bench::Args>),
    #[command(hide = true)]
    RunJob,
}

/// Does what `arguments` ask for, the program's name first, and gives the exit code. `start` starts the program again: its file, and what
/// follows before the arguments, as in `python -m tsdfuse`; empty: the file of this process.
pub fn run(start: Vec<OsString>, arguments: Vec<OsString>) -> u8 {
    program::set(start, arguments.clone());
    exit::ignore_file_size_signal();
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) => return exit::not_parsed(&error),
    };
    exit::code(match &cli.command {
        Command::Fuse(args) => fuse::run(args),
        Command::Map(args) => map::run(args),
        Command::Mesh(args) => mesh::run(args),
        Command::Resume(args) => resume::run(args),
        Command::Render(args) => render::run(args),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(args),
        #[cfg(feature = "serve")]
        Command::Serve(args) => serve::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Info(args) => info::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Odometry(args) => odometry::run(args),
        Command::Poses(args) => poses::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Bench(args) => bench::run(args),
        Command::RunJob => run_job::run(),
    })
}

/// Runs jobs with this program, which `start` starts (see [`run`]), each in a process of its own.
pub fn in_own_process(start: Vec<OsString>) -> impl FnMut(&tsdfuse_run::Job) -> Result<tsdfuse_run::Report, String> {
    program::set(start, Vec::new());
    run_job::in_own_process(None)
}
