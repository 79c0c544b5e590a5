//! `tsdfuse map`: saved maps in, a saved map out.

mod esdf;
mod export;
mod free;
mod plan;

use std::path::PathBuf;

use anyhow::Result;
use clap::Subcommand;
use glam::{DQuat, DVec3, EulerRot};
use tsdfuse::Pose;
use tsdfuse_run::check_outputs;
use tsdfuse_run::operation::{self, Findings};

use crate::args::parse_triple;
use crate::exit::Outcome;
use crate::output::print_json;
use crate::progress::{note, say, working};
use crate::terminal;

const EXAMPLES: &str = "\
Examples:
  tsdfuse map merge monday.tsdf tuesday.tsdf -o week.tsdf
  tsdfuse map crop street.tsdf --from -20,-20,-3 --to 20,20,12 -o crossing.tsdf
  tsdfuse map resample street.tsdf --voxel-size 0.1 -o coarse.tsdf
  tsdfuse map transform street.tsdf --rotation 0,0,90 --translation 691000,5335000,0 -o utm.tsdf
  tsdfuse map align monday.tsdf tuesday.tsdf -o tuesday-there.tsdf
  tsdfuse map repair broken.tsdf -o whole.tsdf
  tsdfuse map export street.tsdf -o street.npz
  tsdfuse map export drive.store -o drive.zarr
  tsdfuse map esdf street.tsdf --voxel-size 0.2 --radius 2 -o distances.npz
  tsdfuse map free drive --heights 0.3..1.8 --inflate 1 -o drive.yaml
  tsdfuse map slice hall.tsdf --height 1.2 -o plan.png
  tsdfuse map section street.tsdf --from 0,-15 --to 0,15 -o section.png
  tsdfuse map terrain drive.tsdf -o ground.tif --surface top.tif --cell 0.25 --epsg 32632
  tsdfuse map ground drive.tsdf --max-step 0.15 -o ground.tif

`tsdfuse info MAP` describes a map.";

/// Merge, crop, resample, transform, align, repair and export saved maps; what robots ask of them; plans and heights.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    #[command(flatten)]
    Operation(Operation),
    /// Write the voxels as arrays (.npz for NumPy, .zarr for xarray), or the surface as points with normals (.ply).
    Export(export::Args),
    /// Write the distance to the nearest surface for all voxels near one, as arrays (.npz for NumPy).
    Esdf(esdf::Args),
    /// Write what a log's rays tell of space: free, occupied or unknown (.bt for OctoMap, .yaml for nav2, .npz for NumPy).
    Free(free::Args),
    Slice(plan::Slice),
    Section(plan::Section),
    Terrain(plan::Terrain),
    Ground(plan::Ground),
}

/// What makes a map of maps.
#[derive(Debug, Subcommand)]
enum Operation {
    /// Add maps with the same grid. The result equals fusing all their scans, bit for bit, if no weight reaches its limit and the method allows it (not: patch with patch.carve, depth, caminal, roldao as published).
    Merge {
        /// The maps.
        #[arg(num_args = 2.., required = true)]
        maps: Vec<PathBuf>,
        #[command(flatten)]
        out: Out,
    },
    /// Keep the voxels whose centres lie in a box.
    Crop {
        /// The map.
        map: PathBuf,
        /// The box's lowest corner, metres [default: none].
        #[arg(long, value_name = "X,Y,Z", value_parser = parse_triple, allow_hyphen_values = true)]
        from: Option<DVec3>,
        /// The box's highest corner, metres [default: none].
        #[arg(long, value_name = "X,Y,Z", value_parser = parse_triple, allow_hyphen_values = true)]
        to: Option<DVec3>,
        #[command(flatten)]
        out: Out,
    },
    /// Change the size of the voxels; the truncation stays.
    Resample {
        /// The map.
        map: PathBuf,
        /// Voxel size, metres.
        #[arg(long, value_name = "M")]
        voxel_size: f64,
        #[command(flatten)]
        out: Out,
    },
    /// Rotate, then translate a map: exact for whole voxels and quarter turns, otherwise resampled.
    Transform {
        /// The map.
        map: PathBuf,
        /// Rotation about x, then y, then z, degrees.
        #[arg(long, value_name = "ROLL,PITCH,YAW", value_parser = parse_triple, allow_hyphen_values = true, default_value = "0,0,0")]
        rotation: DVec3,
        /// Metres.
        #[arg(long, value_name = "X,Y,Z", value_parser = parse_triple, allow_hyphen_values = true, default_value = "0,0,0")]
        translation: DVec3,
        #[command(flatten)]
        out: Out,
    },
    /// Bring a map into the frame of another one: places that both have are recognised, and the whole is registered. Then `map merge`
    /// adds them.
    Align {
        /// The map that stays.
        first: PathBuf,
        /// The map that is moved.
        second: PathBuf,
        #[command(flatten)]
        out: Out,
    },
    /// Recover the intact parts of a damaged map.
    Repair {
        /// The map.
        map: PathBuf,
        #[command(flatten)]
        out: Out,
    },
}

/// Where the result goes.
#[derive(Debug, clap::Args)]
struct Out {
    /// The map to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Print a JSON report.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(Args { command }: &Args) -> Result<Outcome> {
    let operation = match command {
        Command::Operation(operation) => operation,
        Command::Export(export) => return export.run(),
        Command::Esdf(esdf) => return esdf.run(),
        Command::Free(free) => return free.run(),
        Command::Slice(args) => return plan::slice(args),
        Command::Section(args) => return plan::section(args),
        Command::Terrain(args) => return plan::terrain(args),
        Command::Ground(args) => return plan::ground(args),
    };
    let (operation, out) = operation.read();
    check_outputs(&operation.inputs(), &[&out.output])?;
    let spinner = working("working on the map");
    let done = operation.write(&out.output)?;
    drop(spinner);
    let lost = tell(&done.findings);
    terminal::map(&done.map, None);
    terminal::saved_map(&done.saved_map);
    for layer in &done.layers {
        say(format_args!("  wrote    {}", layer.display()));
    }
    if out.json {
        print_json(&done)?;
    }
    Ok(if lost { Outcome::BlocksLost } else { Outcome::Complete })
}

impl Operation {
    /// What is to be done, and where the result goes.
    fn read(&self) -> (operation::Operation, &Out) {
        use operation::Operation as To;
        match self {
            Self::Merge { maps, out } => (To::Merge { maps: maps.clone() }, out),
            Self::Crop { map, from, to, out } => {
                let (low, high) = (from.unwrap_or(DVec3::NEG_INFINITY), to.unwrap_or(DVec3::INFINITY));
                let map = map.clone();
                (To::Crop { map, low, high }, out)
            }
            &Self::Resample {
                ref map,
                voxel_size: voxel_size_m,
                ref out,
            } => {
                let map = map.clone();
                (To::Resample { map, voxel_size_m }, out)
            }
            Self::Transform {
                map,
                rotation,
                translation,
                out,
            } => {
                let [roll, pitch, yaw] = rotation.to_array().map(f64::to_radians);
                let new_from_old = Pose {
                    rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
                    translation: *translation,
                };
                let map = map.clone();
                (To::Transform { map, new_from_old }, out)
            }
            Self::Align { first, second, out } => {
                let (first, second) = (first.clone(), second.clone());
                (To::Align { first, second }, out)
            }
            Self::Repair { map, out } => (To::Repair { map: map.clone() }, out),
        }
    }
}

/// Says what is odd, and whether something is lost.
fn tell(found: &Findings) -> bool {
    if let Some(aligned) = &found.alignment {
        say(format_args!(
            "aligned by {} of {} places; {:.0} % of the surface is in both maps, {:.1} mm apart",
            aligned.agreeing,
            aligned.places,
            100.0 * aligned.common,
            1e3 * aligned.rms_m
        ));
    }
    if let Some(limited) = found.limited_voxels.filter(|&n| n > 0) {
        note(format_args!(
            "{limited} voxels reached max_weight: they hold the mean of all maps, not the exact bits of fusing all scans"
        ));
    }
    match found.exact {
        Some(true) => say(format_args!("moved by whole voxels: all voxels are unchanged")),
        Some(false) => note("moved between voxels: the map was resampled"),
        None => {}
    }
    let Some(damage) = &found.damage else { return false };
    damage.places.iter().for_each(note);
    match damage.lost_blocks {
        Some(0) => say(format_args!("no block is lost")),
        Some(lost) => note(format_args!("{lost} blocks are lost")),
        None => note("how many blocks are lost is not known, since the end of the file is"),
    }
    damage.lost_blocks != Some(0)
}
