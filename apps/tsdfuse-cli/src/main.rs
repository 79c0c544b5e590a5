//! The `tsdfuse` command: LiDAR log in, surface out. It translates; the work is done by the libraries.

mod bench;
mod config;
mod device;
mod eval;
mod evaluate;
mod exit;
mod fuse;
mod info;
mod machine;
mod map;
mod mesh;
mod output;
mod progress;
mod render;
mod report;
mod settings;
mod simulate;
#[cfg_attr(not(feature = "tiles"), path = "tiles/no_tiles.rs")]
mod tiles;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Dense 3D reconstruction from LiDAR: scans and poses in, a surface out.
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
    Resume(fuse::ResumeArgs),
    Render(Box<render::Args>),
    Simulate(simulate::Args),
    Info(info::Args),
    Eval(eval::Args),
    Evaluate(Box<evaluate::Args>),
    Bench(Box<bench::Args>),
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return exit::not_parsed(&error),
    };
    exit::code(match &cli.command {
        Command::Fuse(args) => fuse::run(args),
        Command::Map(args) => map::run(args),
        Command::Mesh(args) => mesh::run(args),
        Command::Resume(args) => fuse::resume(args),
        Command::Render(args) => render::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Info(args) => info::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Bench(args) => bench::run(args),
    })
}
