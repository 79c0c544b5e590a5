//! `tsdfuse view`: a surface in the browser; and what `fuse --view` shares with it.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse_run::report::MapReport;
use tsdfuse_run::{Layers, Stop, scene};
use tsdfuse_view::live::Live;
use tsdfuse_view::{Scene, add_normals};

use crate::exit::{self, Outcome, Usage};
use crate::progress;
use crate::serving;

/// Where a view is served unless an address is given.
pub(crate) const DEFAULT: &str = "127.0.0.1:8642";

const EXAMPLES: &str = "\
Keys: 1 to 9 what is shown, H home, T from above, F fly (W A S D Q E, arrows, Shift), M measure, [ ] cut at a height, P path.

Examples:
  tsdfuse view street.tsdf
  tsdfuse view drive/tileset.json
  tsdfuse view street.ply --address 0.0.0.0:8642";

/// Look at a map, a mesh or tiles in a browser.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// A saved map, a store, a mesh (.ply, .glb, .obj), or NAME/tileset.json of 3D Tiles.
    #[arg(value_name = "PATH")]
    path: PathBuf,
    /// Where to serve it; with the default, only this machine can open it.
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT)]
    address: SocketAddr,
    /// Show no surface of voxels with less weight than this.
    #[arg(long, value_name = "W", default_value_t = MeshConfig::default().min_weight)]
    min_weight: f32,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let config = MeshConfig {
        min_weight: args.min_weight,
    };
    config.validate().map_err(Usage::new)?;
    let stop = exit::stop_on_interrupt()?;
    if args.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        let file = std::fs::metadata(&args.path).with_context(|| args.path.display().to_string())?;
        if !file.is_file() {
            return Err(Usage::new(format_args!("{}: is no tileset.json", args.path.display())).into());
        }
        let live = Live::serve_tiles(args.address, &title(&args.path), args.path.clone())?;
        tell(&live);
        stay(&live, &stop);
        return Ok(Outcome::Complete);
    }
    let spinner = progress::working("reading");
    let (scene, mesh) = args.surface(&config)?;
    drop(spinner);
    let live = open(args.address, &args.path)?;
    let painting = Layers::read_beside(&args.path)?.painting(&mesh);
    painting.with(&mesh, |surface| live.show(&scene, surface));
    stay(&live, &stop);
    Ok(Outcome::Complete)
}

impl Args {
    fn surface(&self, config: &MeshConfig) -> Result<(Scene, tsdfuse::Mesh)> {
        let name = self.path.to_string_lossy();
        if tsdfuse_store::recognises(&self.path) {
            let store = tsdfuse_run::saved::open_store(&self.path)?;
            let poses = store.poses().to_vec();
            let (report, voxel_size_m) = (MapReport::of_paged(&store), store.config().voxel_size_m);
            drop(store);
            let map = tsdfuse_run::saved::read(&self.path)?.0;
            let scene = scene::of_map(&name, voxel_size_m, &report, &poses);
            return Ok((scene, extract_with(&map, config)?));
        }
        if tsdfuse_io::map_file::recognises(&self.path) {
            let (map, poses) = tsdfuse_io::map_file::read_with_poses(&self.path)?;
            let scene = scene::of_map(&name, map.config().voxel_size_m, &MapReport::of(&map), &poses);
            return Ok((scene, extract_with(&map, config)?));
        }
        let mut mesh = tsdfuse_io::mesh::read(&self.path)?;
        add_normals(&mut mesh);
        let figures = [("triangles", mesh.triangles.len()), ("vertices", mesh.vertices.len())];
        let figures = figures.map(|(name, count)| (name.to_owned(), tsdfuse_run::report::with_commas(count as u64)));
        let scene = Scene {
            title: title(&self.path),
            figures: figures.to_vec(),
            ..Scene::default()
        };
        Ok((scene, mesh))
    }
}

fn title(path: &Path) -> String {
    path.file_name()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

/// Opens a view of what is at a path, and tells where.
pub(crate) fn open(address: SocketAddr, path: &Path) -> Result<Live> {
    let live = Live::serve(address, &title(path))?;
    tell(&live);
    Ok(live)
}

fn tell(live: &Live) {
    serving::tell("view", &live.url(), live.address());
}

/// Keeps a view open until Ctrl-C.
pub(crate) fn stay(live: &Live, stop: &Stop) {
    serving::stay("the view", &live.url(), stop, || {});
}
