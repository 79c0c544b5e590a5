//! `tsdfuse map slice`, `map section`, `map terrain` and `map ground`: floor plans, cuts, heights, and what can be driven on.

use std::path::{Path, PathBuf};

use anyhow::Result;
use glam::{DVec2, DVec3};
use tsdfuse::VoxelMap;
use tsdfuse::index::BlockIndex;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse::raster::{GroundConfig, Plane, Raster};
use tsdfuse::render::plan;
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_io::nav2::{self, OccupancyGrid};
use tsdfuse_io::npz::Arrays;
use tsdfuse_io::{geotiff, png};
use tsdfuse_plan::{GroundConfig as GroundGridConfig, GroundGrid};
use tsdfuse_run::{RunError, check_outputs, saved};

use crate::args::parse_pair;
use crate::exit::{Outcome, Usage};
use crate::progress::{say, working};

/// Levels steeper than this are no ground, degrees.
const STEEPEST_DEG: f64 = 50.0;

/// Cut a map at a height: a floor plan.
#[derive(Debug, clap::Args)]
pub(super) struct Slice {
    /// A saved map or a store.
    map: PathBuf,
    /// The height, metres, world.
    #[arg(long, value_name = "Z", allow_hyphen_values = true)]
    height: f64,
    /// A picture with a scale (.png), a grid for ROS's map_server (.yaml, with .pgm), or distances to the surface (.tif, GeoTIFF).
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    place: Place,
}

/// Cut a map along a line.
#[derive(Debug, clap::Args)]
pub(super) struct Section {
    /// A saved map or a store.
    map: PathBuf,
    /// Where the line begins, metres, world.
    #[arg(long, value_name = "X,Y", value_parser = parse_pair, allow_hyphen_values = true)]
    from: DVec2,
    /// Where it ends.
    #[arg(long, value_name = "X,Y", value_parser = parse_pair, allow_hyphen_values = true)]
    to: DVec2,
    /// The picture, with a scale (.png).
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Edge of a pixel, metres [default: half a voxel].
    #[arg(long, value_name = "M")]
    cell: Option<f64>,
}

/// Write heights as GeoTIFF: of the ground, and of all that stands on it.
#[derive(Debug, clap::Args)]
pub(super) struct Terrain {
    /// A saved map or a store.
    map: PathBuf,
    /// The ground, without what stands on it (.tif); gaps are filled from around.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Also write the highest surface (.tif).
    #[arg(long, value_name = "FILE")]
    surface: Option<PathBuf>,
    /// The EPSG code of the log's projected coordinates, such as 32632 for UTM zone 32 north [default: none is written].
    #[arg(long, value_name = "CODE")]
    epsg: Option<u16>,
    #[command(flatten)]
    place: Place,
}

/// Write which ground can be driven on, as a grid seen from above: elevation, slope, step, roughness and traversability.
#[derive(Debug, clap::Args)]
pub(super) struct Ground {
    /// A saved map or a store.
    map: PathBuf,
    /// The layers: bands of a GeoTIFF (.tif), arrays for NumPy (.npz), or costs for nav2 (.yaml, with .pgm).
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The steepest slope that can be driven on, degrees.
    #[arg(long, value_name = "DEG", default_value_t = GroundGridConfig::default().max_slope_deg)]
    max_slope: f64,
    /// The highest step that can be driven over, metres.
    #[arg(long, value_name = "M", default_value_t = GroundGridConfig::default().max_step_m)]
    max_step: f64,
    /// The greatest roughness, metres: how far heights are off the plane around them.
    #[arg(long, value_name = "M", default_value_t = GroundGridConfig::default().max_roughness_m)]
    max_roughness: f64,
    /// What hangs higher than this can be driven under, metres.
    #[arg(long, value_name = "M", default_value_t = GroundGridConfig::default().clearance_m)]
    clearance: f64,
    /// Slope and roughness are those within this distance, metres.
    #[arg(long, value_name = "M", default_value_t = GroundGridConfig::default().radius_m)]
    radius: f64,
    /// The EPSG code of the log's projected coordinates [default: none is written].
    #[arg(long, value_name = "CODE")]
    epsg: Option<u16>,
    #[command(flatten)]
    place: Place,
}

/// Which part, and how fine.
#[derive(Debug, clap::Args)]
struct Place {
    /// The lower left corner, metres, world [default: 40 m around the sensor's path, as far as the map goes].
    #[arg(long, value_name = "X,Y", value_parser = parse_pair, allow_hyphen_values = true)]
    from: Option<DVec2>,
    /// The upper right corner.
    #[arg(long, value_name = "X,Y", value_parser = parse_pair, allow_hyphen_values = true)]
    to: Option<DVec2>,
    /// Edge of a cell, metres [default: a voxel; of ground 0.2, or a voxel where that is larger].
    #[arg(long, value_name = "M")]
    cell: Option<f64>,
}

/// Without a rectangle, what lies around the sensor's path is shown, as far as this, metres.
const AROUND_M: f64 = 40.0;

impl Place {
    /// A raster of the rectangle that was asked for, or of what lies around the path within `low` to `high`.
    fn raster(&self, default_cell_m: f64, poses: &[FusedPose], [low, high]: [DVec3; 2]) -> Result<Raster> {
        let places = || poses.iter().map(|fused| fused.pose.translation.truncate());
        let (mut low, mut high) = (low.truncate(), high.truncate());
        if let (Some(first), Some(last)) = (places().reduce(DVec2::min), places().reduce(DVec2::max)) {
            let (first, last) = ((first - AROUND_M).max(low), (last + AROUND_M).min(high));
            if first.cmplt(last).all() {
                (low, high) = (first, last);
            }
        }
        // Whole cells, so that rasters of one map fit together.
        let cell_m = self.cell.unwrap_or(default_cell_m);
        (low, high) = ((low / cell_m).floor() * cell_m, (high / cell_m).ceil() * cell_m);
        let (low, high) = (self.from.unwrap_or(low), self.to.unwrap_or(high));
        Ok(Raster::covering(low, high, cell_m).map_err(Usage::new)?)
    }
}

/// The box of the blocks that are wanted.
fn bounds(map: &VoxelMap, path: &Path, is_wanted: impl Fn(&[DVec3; 2]) -> bool) -> Result<[DVec3; 2]> {
    let (voxel_m, edge) = (map.config().voxel_size_m, 8);
    let corners = |BlockIndex(block): BlockIndex| [block, block + 1].map(|corner| (corner * edge).as_dvec3() * voxel_m);
    let boxes = map.block_indices().into_iter().map(corners).filter(is_wanted);
    let both = boxes.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
    let nothing = || RunError::Nothing(format!("{}: nothing was observed there", path.display()));
    Ok(both.ok_or_else(nothing)?)
}

fn told(raster: &Raster, outputs: &[&Path]) -> Outcome {
    let percent = 100.0 * raster.known() as f64 / raster.values.len() as f64;
    say(format_args!(
        "  raster   {} x {} cells of {} m, {percent:.1}% known",
        raster.width, raster.height, raster.cell_m
    ));
    outputs
        .iter()
        .for_each(|output| say(format_args!("  wrote    {}", output.display())));
    Outcome::Complete
}

/// What lies behind a surface is occupied, as the surface itself.
fn occupancy(slice: &Raster) -> OccupancyGrid {
    let half = (slice.cell_m / 2.0) as f32;
    let cost = |&distance: &f32| (!distance.is_nan()).then_some(if distance > half { 0 } else { 100 });
    OccupancyGrid {
        origin: slice.low,
        cell_m: slice.cell_m,
        width: slice.width,
        costs: slice.values.chunks(slice.width).rev().flatten().map(cost).collect(),
    }
}

pub(super) fn slice(args: &Slice) -> Result<Outcome> {
    let is_png = png::check(&args.output).is_ok();
    let is_grid = args.output.extension().is_some_and(|e| e == "yaml" || e == "yml");
    if !(is_png || is_grid || geotiff::is_geotiff(&args.output)) {
        let output = args.output.display();
        return Err(Usage::new(format_args!("{output}: a slice is written as .png, .yaml or .tif")).into());
    }
    let picture = is_grid.then(|| nav2::picture_beside(&args.output)).transpose()?;
    let outputs: Vec<&Path> = std::iter::once(&*args.output).chain(picture.as_deref()).collect();
    check_outputs(&[&args.map], &outputs)?;
    let _spinner = working("cutting");
    let (map, poses) = saved::read(&args.map)?;
    let at_height = |[low, high]: &[DVec3; 2]| low.z <= args.height && args.height < high.z;
    let raster = args
        .place
        .raster(map.config().voxel_size_m, &poses, bounds(&map, &args.map, at_height)?)?;
    let raster = raster.slice(&map, &Plane::level(args.height));
    if is_png {
        png::write(&args.output, &plan(&raster))?;
    } else if is_grid {
        nav2::write(&args.output, &occupancy(&raster))?;
    } else {
        geotiff::write(&args.output, &raster, None)?;
    }
    Ok(told(&raster, &outputs))
}

pub(super) fn section(args: &Section) -> Result<Outcome> {
    png::check(&args.output).map_err(Usage::new)?;
    check_outputs(&[&args.map], &[&args.output])?;
    let plane = Plane::vertical(args.from, args.to).ok_or_else(|| Usage::new("--from and --to are one place"))?;
    let _spinner = working("cutting");
    let (map, _) = saved::read(&args.map)?;
    let length_m = args.from.distance(args.to);
    // Heights of the blocks that the line passes.
    let (low, high) = (args.from.min(args.to), args.from.max(args.to));
    let is_passed = |[first, last]: &[DVec3; 2]| {
        let (middle, half) = ((*first + *last).truncate() / 2.0 - args.from, (*last - *first).x);
        let aside = plane.right.truncate().perp_dot(middle).abs();
        let beside = first.truncate().cmple(high).all() && last.truncate().cmpge(low).all();
        aside <= half && beside
    };
    let [low, high] = bounds(&map, &args.map, is_passed)?;
    let cell_m = args.cell.unwrap_or(0.5 * map.config().voxel_size_m);
    let raster = Raster::covering(DVec2::new(0.0, low.z), DVec2::new(length_m, high.z), cell_m).map_err(Usage::new)?;
    let raster = raster.slice(&map, &plane);
    png::write(&args.output, &plan(&raster))?;
    Ok(told(&raster, &[&args.output]))
}

pub(super) fn terrain(args: &Terrain) -> Result<Outcome> {
    let outputs: Vec<&Path> = std::iter::once(&*args.output).chain(args.surface.as_deref()).collect();
    if let Some(other) = outputs.iter().find(|output| !geotiff::is_geotiff(output)) {
        return Err(Usage::new(format_args!("{}: heights are written as .tif", other.display())).into());
    }
    check_outputs(&[&args.map], &outputs)?;
    let _spinner = working("finding the ground");
    let (map, poses) = saved::read(&args.map)?;
    let raster = args
        .place
        .raster(map.config().voxel_size_m, &poses, bounds(&map, &args.map, |_| true)?)?;
    let mesh = extract_with(&map, &MeshConfig::default())?;
    drop(map);
    let lowest = raster.clone().lowest_level(&mesh, STEEPEST_DEG.to_radians());
    if lowest.known() == 0 {
        return Err(RunError::Nothing(format!("{}: no surface there faces up", args.map.display())).into());
    }
    let ground = lowest.ground(&GroundConfig::default());
    geotiff::write(&args.output, &ground, args.epsg)?;
    if let Some(path) = &args.surface {
        geotiff::write(path, &raster.highest(&mesh), args.epsg)?;
    }
    Ok(told(&ground, &outputs))
}

/// Cells of ground, metres, if voxels are no larger.
const GROUND_CELL_M: f64 = 0.2;

pub(super) fn ground(args: &Ground) -> Result<Outcome> {
    let extension = args.output.extension().map(|e| e.to_string_lossy().to_lowercase());
    let is_grid = matches!(extension.as_deref(), Some("yaml" | "yml"));
    let is_npz = extension.as_deref() == Some("npz");
    if !(is_grid || is_npz || geotiff::is_geotiff(&args.output)) {
        let output = args.output.display();
        return Err(Usage::new(format_args!("{output}: ground is written as .tif, .npz or .yaml")).into());
    }
    let config = GroundGridConfig {
        radius_m: args.radius,
        clearance_m: args.clearance,
        max_slope_deg: args.max_slope,
        max_step_m: args.max_step,
        max_roughness_m: args.max_roughness,
    };
    let picture = is_grid.then(|| nav2::picture_beside(&args.output)).transpose()?;
    let outputs: Vec<&Path> = std::iter::once(&*args.output).chain(picture.as_deref()).collect();
    check_outputs(&[&args.map], &outputs)?;
    let _spinner = working("finding the ground");
    let (map, poses) = saved::read(&args.map)?;
    let cell_m = GROUND_CELL_M.max(map.config().voxel_size_m);
    let shape = args.place.raster(cell_m, &poses, bounds(&map, &args.map, |_| true)?)?;
    let mesh = extract_with(&map, &MeshConfig::default())?;
    drop(map);
    let ground = GroundGrid::of(&mesh, &shape, &config).map_err(Usage::new)?;
    if ground.elevation.known() == 0 {
        return Err(RunError::Nothing(format!("{}: no surface there faces up", args.map.display())).into());
    }
    if is_npz {
        write_arrays(&args.output, &ground)?;
    } else if is_grid {
        let cost = |&share: &f32| (!share.is_nan()).then_some((100.0 * (1.0 - share)).round() as u8);
        let traversability = &ground.traversability;
        let grid = OccupancyGrid {
            origin: traversability.low,
            cell_m: traversability.cell_m,
            width: traversability.width,
            costs: traversability
                .values
                .chunks(traversability.width)
                .rev()
                .flatten()
                .map(cost)
                .collect(),
        };
        nav2::write(&args.output, &grid)?;
    } else {
        geotiff::write_layers(&args.output, &ground.layers(), args.epsg)?;
    }
    let drivable = ground
        .traversability
        .values
        .iter()
        .filter(|share| **share > 0.0)
        .count();
    let outcome = told(&ground.elevation, &outputs);
    say(format_args!(
        "  drivable {:.0} m²",
        drivable as f64 * cell_area(&ground.elevation)
    ));
    Ok(outcome)
}

fn cell_area(raster: &Raster) -> f64 {
    raster.cell_m * raster.cell_m
}

/// Layers as arrays, row by row from the highest y on.
fn write_arrays(path: &Path, ground: &GroundGrid) -> Result<()> {
    let Raster {
        low,
        cell_m,
        width,
        height,
        ..
    } = ground.elevation;
    tsdfuse_io::atomic::write(path, |out| {
        let mut arrays = Arrays::new(out);
        for (name, layer) in ground.layers() {
            arrays.add(name, &[height, width], layer.values.iter().copied())?;
        }
        arrays.add("low_m", &[2], low.to_array())?;
        arrays.add("cell_m", &[], [cell_m])?;
        arrays.finish()
    })?;
    Ok(())
}
