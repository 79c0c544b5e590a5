//! `tsdfuse render`: a saved map in, pictures of it out.

mod look;
mod name;
mod scan;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use clap::ArgGroup;
use clap::builder::PossibleValuesParser;
use glam::DVec3;
use serde::Serialize;
use tsdfuse::SensorModel;
use tsdfuse::fuse::pictures::Picture;
use tsdfuse::render::{Camera, ImageKind, RenderConfig};
use tsdfuse::sensor::Pinhole;
use tsdfuse_run::movie::{Movie, is_movie};
use tsdfuse_run::report::{MapReport, ViewReport};
use tsdfuse_run::{Device, Layers, RunError, check_outputs, view};

use crate::exit::{self, Outcome, Usage};
use crate::output::print_json;
use crate::progress::{self, note, say};
use crate::terminal;
use look::LookArgs;

const MORE_HELP: &str = "\
Camera frame: x forward, y left, z up. Positive YAW turns left, PITCH up, ROLL lowers the right side; degrees. A pose file holds \
camera-to-world poses: KITTI or TUM lines, or one matrix of 3 or 4 lines.

Pictures: shaded; height; intensity and color, as they were saved beside the map (fuse --intensity --color --save-map); normal (red, green, blue = x, y, z); depth (16 bits, millimetres, 0 = no surface, at most 65.535 m); weight \
(dark = 0.01, bright = 100, logarithmic). Several views are numbered, several pictures named: view-03-depth.png.

Surface is visible only from the side it was measured from.

Examples:
  tsdfuse render street.tsdf -o view.png
  tsdfuse render street.tsdf -o view.png --from 0,0,2 --to 20,5,1 --image shaded,depth
  tsdfuse render street.tsdf -o height.png --image height
  tsdfuse render street.tsdf -o turn.png --views 36
  tsdfuse render street.tsdf -o flight.mp4 --along-path
  tsdfuse render street.tsdf -o scan.png --pose 0,0,1.8 --sensor pandar64
  tsdfuse render pandaset/002 -o scan.png --scan 5 --image normals,surfels,filled";

/// Pictures of a map beside those of [`ImageKind`].
const LAYERS: [&str; 3] = ["height", "intensity", "color"];

/// Render pictures of a saved map.
#[derive(Debug, clap::Args)]
#[command(after_help = MORE_HELP, group(ArgGroup::new("place").args(["pose", "poses", "from"])),
    group(ArgGroup::new("look").args(["overview", "views", "along_path", "pose", "poses", "from"])))]
pub(crate) struct Args {
    /// A map saved with `tsdfuse fuse --save-map`, or a store; with --scan a log.
    map: PathBuf,
    /// Draw what methods make of scan N of a log instead: its normals, surfels or cylindrical images.
    #[arg(long, value_name = "N", conflicts_with_all = ["look", "sensor", "size", "fov", "optical", "json"])]
    scan: Option<usize>,
    /// The picture to write, .png; several views also as a movie, .mp4, where ffmpeg is installed.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    look: LookArgs,
    /// What to render; separate several with commas.
    #[arg(long, value_name = "KIND", value_delimiter = ',',
        value_parser = PossibleValuesParser::new(ImageKind::ALL.map(ImageKind::name).into_iter().chain(LAYERS).chain(Picture::ALL.map(Picture::name))))]
    image: Vec<String>,
    /// Render as this LiDAR sees: a row per beam, a column per firing, clockwise from straight ahead.
    #[arg(long, value_name = "NAME", requires = "place", conflicts_with_all = ["size", "fov"],
        value_parser = PossibleValuesParser::new(tsdfuse::sensor::names()))]
    sensor: Option<String>,
    /// Ignore voxels with less weight than this.
    #[arg(long, value_name = "W", default_value_t = RenderConfig::default().min_weight)]
    min_weight: f32,
    /// Ignore surface farther away than this, metres.
    #[arg(long, value_name = "M", default_value_t = RenderConfig::default().max_range_m)]
    max_range: f32,
    /// Print a JSON report.
    #[arg(long)]
    json: bool,
    /// What renders.
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    device: Device,
}

/// What was done. Times are seconds of wall time.
#[derive(Debug, Serialize)]
struct Done {
    /// The file that was read.
    path: PathBuf,
    read_seconds: f64,
    map: MapReport,
    config: RenderConfig,
    camera: Option<Pinhole>,
    sensor: Option<SensorModel>,
    /// Finding the surface, once.
    prepare_seconds: f64,
    views: Vec<ViewReport>,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    if let Some(number) = args.scan {
        return scan::run(&args.map, number, &args.pictures()?, &args.output);
    }
    let config = RenderConfig {
        min_weight: args.min_weight,
        max_range_m: args.max_range,
    };
    exit::quiet_gpu(&args.device);
    config.validate().map_err(Usage::new)?;
    if is_movie(&args.output) {
        args.check_movie()?;
    } else {
        tsdfuse_io::png::check(&args.output).map_err(Usage::new)?;
    }
    args.check_kinds()?;
    let layers = args.layers()?;
    let pictures = args.pictures_of_map(&layers);
    let pinhole = args.look.camera()?;
    let sensor = args.sensor.as_deref().and_then(tsdfuse::sensor::model);
    let place = look::eye(&args.look)?;
    let mut inputs = vec![args.map.as_path()];
    inputs.extend(args.look.poses.as_deref());
    check_outputs(&inputs, &[&args.output])?;

    let start = Instant::now();
    let (map, fused) = tsdfuse_run::saved::read(&args.map)?;
    let driven: Vec<DVec3> = fused.iter().map(|fused| fused.pose.translation).collect();
    let read_seconds = start.elapsed().as_secs_f64();
    let spinner = progress::working("rendering");
    let preparing = Instant::now();
    let renderer = view::renderer(&map, &config)?;
    let mut look = args.device.look(&renderer, &config)?;
    let prepare_seconds = preparing.elapsed().as_secs_f64();
    let poses = place.poses(&renderer, &pinhole, &driven);
    if poses.is_empty() {
        return Err(RunError::Nothing(format!("{}: tells no path of a sensor that moved", args.map.display())).into());
    }
    let camera = sensor.clone().map_or(Camera::Pinhole(pinhole), Camera::Lidar);
    let mut views = Vec::with_capacity(poses.len());
    let mut movie = is_movie(&args.output)
        .then(|| Movie::begin(&args.output, &pinhole))
        .transpose()?;
    for (number, pose) in poses.iter().enumerate() {
        if let Some(movie) = &mut movie {
            views.push(movie.add(&mut look, &camera, *pose)?);
            continue;
        }
        let files: Vec<_> = pictures
            .iter()
            .map(|&(name, picture)| {
                let path = name::of(&args.output, (number, poses.len()), (name, pictures.len()));
                (picture, path)
            })
            .collect();
        views.push(view::write(&mut look, &camera, *pose, &files)?);
    }
    movie.map(Movie::finish).transpose()?;
    drop(spinner);
    let done = Done {
        path: args.map.clone(),
        read_seconds,
        map: MapReport::of(&map),
        config,
        camera: sensor.is_none().then_some(pinhole),
        sensor,
        prepare_seconds,
        views,
    };
    done.summarize(start.elapsed().as_secs_f64());
    if args.json {
        print_json(&done)?;
    }
    Ok(Outcome::Complete)
}

impl Args {
    fn check_movie(&self) -> Result<(), Usage> {
        if !self.look.along_path && self.look.views.is_none() && self.look.poses.is_none() {
            return Err(Usage::new(
                "a movie needs several views: --along-path, --views or --poses",
            ));
        }
        if self.sensor.is_some() || self.image.iter().any(|name| name != ImageKind::Shaded.name()) {
            return Err(Usage::new("a movie shows the shaded surface through a pinhole camera"));
        }
        Ok(())
    }

    fn check_kinds(&self) -> Result<(), Usage> {
        let names: Vec<&str> = ImageKind::ALL.map(ImageKind::name).into_iter().chain(LAYERS).collect();
        self.none_else(&names, "is a picture of a scan: say which with --scan")
    }

    fn is_asked(&self, name: &str) -> bool {
        if self.image.is_empty() {
            name == ImageKind::default().name()
        } else {
            self.image.iter().any(|asked| asked == name)
        }
    }

    /// The layers beside the map that pictures need.
    fn layers(&self) -> Result<Layers> {
        let [_, intensity, color] = LAYERS.map(|name| self.is_asked(name));
        if !intensity && !color {
            return Ok(Layers::default());
        }
        let layers = Layers::read_beside(&self.map)?;
        let missing = [
            (intensity && layers.intensity.is_none(), "intensity"),
            (color && layers.colors.is_none(), "color"),
        ];
        if let Some((_, name)) = missing.into_iter().find(|(is_missing, _)| *is_missing) {
            return Err(Usage::new(format_args!(
                "--image {name}: none is saved beside {}; tsdfuse fuse --{name} --save-map saves it",
                self.map.display()
            ))
            .into());
        }
        Ok(layers)
    }

    /// The pictures of a map to make of each view; none twice.
    fn pictures_of_map<'a>(&self, layers: &'a Layers) -> Vec<(&'static str, view::Picture<'a>)> {
        let plain = ImageKind::ALL.map(|kind| (kind.name(), Some(view::Picture::Plain(kind))));
        let [height, intensity, color] = LAYERS;
        let others = [
            (height, Some(view::Picture::Height)),
            (intensity, layers.intensity.as_ref().map(view::Picture::Intensity)),
            (color, layers.colors.as_ref().map(view::Picture::Color)),
        ];
        let all = plain.into_iter().chain(others).filter(|(name, _)| self.is_asked(name));
        all.filter_map(|(name, picture)| Some((name, picture?))).collect()
    }

    /// The pictures of a scan to make; none twice.
    fn pictures(&self) -> Result<Vec<Picture>, Usage> {
        let asked = |picture: &Picture| {
            if self.image.is_empty() {
                *picture == Picture::Normals
            } else {
                self.image.iter().any(|name| name == picture.name())
            }
        };
        self.none_else(
            Picture::ALL.map(Picture::name).as_slice(),
            "is a picture of a map: leave out --scan",
        )?;
        Ok(Picture::ALL.into_iter().filter(asked).collect())
    }

    fn none_else(&self, possible: &[&str], otherwise: &str) -> Result<(), Usage> {
        let other = self.image.iter().find(|name| !possible.contains(&name.as_str()));
        other.map_or(Ok(()), |name| {
            Err(Usage::new(format_args!("--image {name}: {otherwise}")))
        })
    }
}

/// How much of a picture shows surface, percent.
fn surface_percent(view: &ViewReport) -> f64 {
    100.0 * view.surface_pixels as f64 / (view.width * view.height) as f64
}

impl Done {
    /// A few lines for people.
    fn summarize(&self, wall_seconds: f64) {
        terminal::map(&self.map, None);
        let [Some(first), Some(last)] = [self.views.first(), self.views.last()] else {
            return;
        };
        let percent = self.views.iter().map(surface_percent);
        let (least, most) = percent.fold((100.0_f64, 0.0_f64), |(l, m), p| (l.min(p), m.max(p)));
        let size = format!("{} x {} pixels", first.width, first.height);
        match self.views.len() {
            1 => say(format_args!("  view     {size}, {most:.0}% show surface")),
            n => say(format_args!(
                "  views    {n} of {size}, {least:.0}% to {most:.0}% show surface"
            )),
        }
        let sum = |of: fn(&ViewReport) -> f64| self.views.iter().map(of).sum::<f64>();
        say(format_args!(
            "  seconds  read {:.2}, prepare {:.2}, render {:.2}, write {:.2}; in all {wall_seconds:.2}",
            self.read_seconds,
            self.prepare_seconds,
            sum(|view| view.seconds),
            sum(|view| view.write_seconds),
        ));
        match (first.files.first(), last.files.last()) {
            (Some(from), Some(to)) if from != to => {
                say(format_args!("  wrote    {} to {}", from.display(), to.display()));
            }
            _ => terminal::pictures(first),
        }
        if most == 0.0 {
            note("no surface is visible from there");
        }
    }
}
