//! The `tsdfuse` command: LiDAR log in, surface out. It translates; the work is done by the libraries.

mod args;
mod bench;
mod convert;
mod eval;
mod evaluate;
mod exit;
mod fuse;
mod info;
mod map;
mod maps;
mod measuring;
mod mesh;
mod odometry;
mod output;
mod poses;
mod progress;
mod render;
mod resume;
mod run_job;
mod simulate;
mod terminal;

use std::process::ExitCode;

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

fn main() -> ExitCode {
    exit::ignore_file_size_signal();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return exit::not_parsed(&error),
    };
    exit::code(match &cli.command {
        Command::Fuse(args) => fuse::run(args),
        Command::Map(args) => map::run(args),
        Command::Mesh(args) => mesh::run(args),
        Command::Resume(args) => resume::run(args),
        Command::Render(args) => render::run(args),
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
