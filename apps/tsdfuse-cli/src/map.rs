//! `tsdfuse map`: saved maps in, a saved map out.

mod esdf;
mod export;
mod free;
mod plan;
#[cfg(feature = "zarr")]
mod zarr;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use glam::{DQuat, DVec3, EulerRot};
use serde::Serialize;
use tsdfuse::{Pose, VoxelMap};
use tsdfuse_io::map_file::{self, Damage, FusedPose, Reader};
use tsdfuse_loops::{Alignment, Mapped};

use tsdfuse_run::report::{MapReport, SavedMap};
use tsdfuse_run::{check_outputs, layer};
use tsdfuse_store::Salvage;

use crate::args::parse_triple;
use crate::exit::{Outcome, Usage};
use crate::maps::read_with_poses;
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
#[derive(Clone, Debug, clap::Args)]
struct Out {
    /// The map to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Print a JSON report.
    #[arg(long)]
    json: bool,
}

/// What was done.
#[derive(Debug, Serialize)]
struct Done {
    map: MapReport,
    saved_map: SavedMap,
    /// How the second map was aligned.
    #[serde(skip_serializing_if = "Option::is_none")]
    alignment: Option<Aligned>,
    /// Merged voxels that are at the weight's limit: a mean of all maps, but not the bits that fusing would give.
    limited_voxels: Option<u64>,
    /// Whether the motion only renumbered voxels.
    exact: Option<bool>,
    damage: Option<Damage>,
}

/// How a map lies in the frame of another one.
#[derive(Debug, Serialize)]
struct Aligned {
    /// The row-major 3×4 matrix.
    first_from_second: [f64; 12],
    /// Places along the second map's way that were looked for in the first.
    places: usize,
    /// Of these, those that were recognised and agree.
    agreeing: usize,
    /// Those that were recognised, and say something else.
    contradicting: usize,
    /// Root mean square of distances between both surfaces where both are, metres.
    rms_m: f64,
    /// Share of the second surface that lies where the first map has one.
    common: f64,
}

/// A map, and what is to be said of it.
struct Made {
    map: VoxelMap,
    /// Of its scans.
    poses: Vec<FusedPose>,
    alignment: Option<Aligned>,
    limited_voxels: Option<u64>,
    exact: Option<bool>,
    damage: Option<Damage>,
}

impl From<(VoxelMap, Vec<FusedPose>)> for Made {
    fn from((map, poses): (VoxelMap, Vec<FusedPose>)) -> Self {
        Self {
            map,
            poses,
            alignment: None,
            limited_voxels: None,
            exact: None,
            damage: None,
        }
    }
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
    let out = operation.out();
    check_outputs(&operation.inputs(), &[&out.output])?;
    let spinner = working("working on the map");
    let made = operation.run()?;
    let start = Instant::now();
    map_file::write_with_poses(&out.output, &made.map, &made.poses)?;
    let layers = operation.run_for_layers()?;
    drop(spinner);
    let done = Done {
        map: MapReport::of(&made.map),
        saved_map: SavedMap::written(&out.output, start),
        alignment: made.alignment,
        limited_voxels: made.limited_voxels,
        exact: made.exact,
        damage: made.damage,
    };
    let lost = done.say();
    terminal::map(&done.map, None);
    terminal::saved_map(&done.saved_map);
    for layer in layers {
        say(format_args!("  wrote    {}", layer.display()));
    }
    if out.json {
        print_json(&done)?;
    }
    Ok(if lost { Outcome::BlocksLost } else { Outcome::Complete })
}

impl Operation {
    /// Does the same to the intensities and colours that lie beside all of the maps; what was written. Of a repaired map they are left
    /// alone, since they may be whole; resampled and aligned ones are none.
    fn run_for_layers(&self) -> Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        for name in layer::NAMES {
            let beside = |path: &Path| layer::path_beside(path, name);
            if !self.inputs().iter().all(|path| beside(path).is_file()) {
                continue;
            }
            let made = match self {
                Self::Merge { maps, .. } => merge(&maps.iter().map(|map| beside(map)).collect::<Vec<_>>())?,
                Self::Crop { map, from, to, out } => Self::Crop {
                    map: beside(map),
                    from: *from,
                    to: *to,
                    out: out.clone(),
                }
                .run()?,
                Self::Transform {
                    map,
                    rotation,
                    translation,
                    out,
                } => Self::Transform {
                    map: beside(map),
                    rotation: *rotation,
                    translation: *translation,
                    out: out.clone(),
                }
                .run()?,
                Self::Resample { .. } | Self::Align { .. } | Self::Repair { .. } => continue,
            };
            let path = beside(&self.out().output);
            map_file::write_with_poses(&path, &made.map, &[])?;
            written.push(path);
        }
        Ok(written)
    }

    /// Where the map goes.
    fn out(&self) -> &Out {
        match self {
            Self::Merge { out, .. }
            | Self::Crop { out, .. }
            | Self::Resample { out, .. }
            | Self::Transform { out, .. }
            | Self::Align { out, .. }
            | Self::Repair { out, .. } => out,
        }
    }

    /// The maps that are read.
    fn inputs(&self) -> Vec<&Path> {
        match self {
            Self::Merge { maps, .. } => maps.iter().map(PathBuf::as_path).collect(),
            Self::Align { first, second, .. } => vec![first, second],
            Self::Crop { map, .. }
            | Self::Resample { map, .. }
            | Self::Transform { map, .. }
            | Self::Repair { map, .. } => vec![map],
        }
    }

    fn run(&self) -> Result<Made> {
        let named = |path: &Path| path.display().to_string();
        match self {
            Self::Merge { maps, .. } => merge(maps),
            Self::Crop { map, from, to, .. } => {
                let (low, high) = (from.unwrap_or(DVec3::NEG_INFINITY), to.unwrap_or(DVec3::INFINITY));
                let (map, poses) = read_with_poses(map)?;
                // Scans from outside of the box have seen what is in it.
                Ok((map.cropped(low, high).map_err(Usage::new)?, poses).into())
            }
            Self::Resample { map, voxel_size, .. } => {
                let (old, poses) = read_with_poses(map)?;
                let resampled = old.resampled(*voxel_size).with_context(|| named(map))?;
                Ok((resampled, poses).into())
            }
            Self::Transform {
                map,
                rotation,
                translation,
                ..
            } => {
                let [roll, pitch, yaw] = rotation.to_array().map(f64::to_radians);
                let pose = Pose {
                    rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
                    translation: *translation,
                };
                let (old, mut poses) = read_with_poses(map)?;
                let (moved, exact) = old.transformed(&pose).with_context(|| named(map))?;
                poses.iter_mut().for_each(|fused| fused.pose = pose * fused.pose);
                Ok(Made {
                    exact: Some(exact),
                    ..(moved, poses).into()
                })
            }
            Self::Align { first, second, .. } => align(first, second),
            Self::Repair { map, .. } if tsdfuse_store::recognises(map) => {
                let salvage = Salvage::scan(map)?;
                Ok(Made {
                    damage: Some(Damage {
                        places: salvage.damage().places.clone(),
                        lost_blocks: salvage.damage().lost.as_ref().map(|(_, blocks)| *blocks),
                    }),
                    ..(salvage.map()?, salvage.poses().to_vec()).into()
                })
            }
            Self::Repair { map, .. } => {
                let map_file::Repaired { map, poses, damage } = map_file::repair(map)?;
                Ok(Made {
                    damage: Some(damage),
                    ..(map, poses).into()
                })
            }
        }
    }
}

/// The first map, with the blocks of the others added as they are read, and the poses of all, one map after the other.
fn merge(paths: &[PathBuf]) -> Result<Made> {
    let (first, others) = paths.split_first().context("maps are wanted")?;
    let (mut map, mut poses) = read_with_poses(first)?;
    let mut limited = 0;
    for path in others {
        let mut reader = Reader::open(path)?;
        let same = map.config().check_same(reader.config());
        same.with_context(|| format!("{} and {}", first.display(), path.display()))?;
        let integrations = map.integrations().wrapping_add(reader.integrations());
        poses.extend(reader.take_poses());
        reader.for_each_block(|index, block| {
            limited += map.add_block(index, &block)?;
            Ok(())
        })?;
        map.set_integrations(integrations);
    }
    Ok(Made {
        limited_voxels: Some(limited),
        ..(map, poses).into()
    })
}

/// The second map in the frame of the first.
fn align(first: &Path, second: &Path) -> Result<Made> {
    let mapped = |path: &Path| {
        let (map, poses) = read_with_poses(path)?;
        if poses.is_empty() {
            bail!(
                "{}: does not tell the poses of its scans, along which places are looked for",
                path.display()
            );
        }
        let mapped = Mapped {
            surface: tsdfuse::mesh::extract(&map)?.vertices,
            poses: poses.iter().map(|fused| fused.pose).collect(),
        };
        Ok((map, poses, mapped))
    };
    let (_, _, there) = mapped(first)?;
    let (map, mut poses, own) = mapped(second)?;
    let Some(alignment) = tsdfuse_loops::align(&there, &own) else {
        bail!(
            "{}: too few places of it were recognised in {}, or they disagree: the map was not moved",
            second.display(),
            first.display()
        );
    };
    let (moved, exact) = map
        .transformed(&alignment.pose)
        .with_context(|| second.display().to_string())?;
    poses
        .iter_mut()
        .for_each(|fused| fused.pose = alignment.pose * fused.pose);
    Ok(Made {
        exact: Some(exact),
        alignment: Some(alignment.into()),
        ..(moved, poses).into()
    })
}

impl From<Alignment> for Aligned {
    fn from(alignment: Alignment) -> Self {
        Self {
            first_from_second: alignment.pose.to_row_major_3x4(),
            places: alignment.places,
            agreeing: alignment.agreeing,
            contradicting: alignment.contradicting,
            rms_m: alignment.rms_m,
            common: alignment.common,
        }
    }
}

impl Done {
    /// Says what is odd, and whether something is lost.
    fn say(&self) -> bool {
        if let Some(aligned) = &self.alignment {
            say(format_args!(
                "aligned by {} of {} places; {:.0} % of the surface is in both maps, {:.1} mm apart",
                aligned.agreeing,
                aligned.places,
                100.0 * aligned.common,
                1e3 * aligned.rms_m
            ));
        }
        if let Some(limited) = self.limited_voxels.filter(|&n| n > 0) {
            note(format_args!(
                "{limited} voxels reached max_weight: they hold the mean of all maps, not the exact bits of fusing all scans"
            ));
        }
        match self.exact {
            Some(true) => say(format_args!("moved by whole voxels: all voxels are unchanged")),
            Some(false) => note("moved between voxels: the map was resampled"),
            None => {}
        }
        let Some(damage) = &self.damage else { return false };
        damage.places.iter().for_each(note);
        match damage.lost_blocks {
            Some(0) => say(format_args!("no block is lost")),
            Some(lost) => note(format_args!("{lost} blocks are lost")),
            None => note("how many blocks are lost is not known, since the end of the file is"),
        }
        damage.lost_blocks != Some(0)
    }
}
