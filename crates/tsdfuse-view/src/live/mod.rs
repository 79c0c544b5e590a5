//! A surface in the browser while it grows: pieces that changed, where the sensor is, figures.
//!
//! ```text
//!   who fuses ─▶ Live: pieces by the order in which they changed last, path, sweep, figures
//!                  │  for each viewer: all that changed since it was told last, half a megabyte at a time,
//!                  ▼  and the next only when the browser has shown this
//!               viewer
//! ```
//!
//! So a slow viewer slows nothing down, needs no memory here, and skips what changed again meanwhile. A viewer that comes late gets everything.

mod server;
mod state;

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::mesh::Changes;

use crate::chunks::{self, Lattice};
use crate::pack::{Piece, octahedral};
use crate::page;
use crate::scene::{Scene, Surface};
use server::Server;
use state::{Shared, State};

/// The port unless another one is asked for; if it is taken, any other.
const PORT: u16 = 8642;

/// Steps of a voxel: vertices of blocks are rounded to these.
const STEPS_OF_VOXEL: f64 = 64.0;

/// Where viewers connect: the loopback address by default, which only this machine reaches.
pub const ADDRESS: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), PORT);

/// A live view: viewers see at once what it is given. Clones are the same view.
#[derive(Clone, Debug)]
pub struct Live {
    shared: Arc<Shared>,
    server: Arc<Server>,
}

impl Live {
    /// Serves a view that shows nothing yet, at an address.
    ///
    /// # Errors
    /// If nobody can listen there; a port that is taken is no error where it is the default.
    pub fn serve(address: SocketAddr, title: &str) -> io::Result<Self> {
        Self::serve_with(address, title, None)
    }

    /// Serves the tiles beside a `tileset.json`.
    ///
    /// # Errors
    /// As [`Self::serve`].
    pub fn serve_tiles(address: SocketAddr, title: &str, tileset: PathBuf) -> io::Result<Self> {
        Self::serve_with(address, title, Some(tileset))
    }

    fn serve_with(address: SocketAddr, title: &str, tileset: Option<PathBuf>) -> io::Result<Self> {
        let shared = Arc::new(Shared::new(State::new(title)));
        let server = Server::start(address, title, shared.clone(), tileset)?;
        Ok(Self {
            shared,
            server: Arc::new(server),
        })
    }

    /// What is opened in a browser. Whoever knows it may look.
    pub fn url(&self) -> String {
        self.server.url()
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// How many look.
    pub fn viewers(&self) -> usize {
        self.server.viewers()
    }

    /// Tells the voxel size of a map, whose pieces will come, and a point near them, world; once.
    pub fn begin(&self, origin: DVec3, voxel_size_m: f64) {
        let lattice = Lattice {
            origin: origin.round(),
            step_m: voxel_size_m / STEPS_OF_VOXEL,
        };
        self.shared.change(|state| state.begin(lattice, true));
    }

    /// Tells the pieces of the surface that changed, after [`Self::begin`].
    pub fn changes(&self, changes: &Changes) {
        let Some(lattice) = self.shared.look(State::lattice) else {
            return;
        };
        let pieces: Vec<_> = changes.iter().collect();
        let packed = pieces.into_par_iter().map_init(Packer::default, |packer, piece| {
            let bytes = packer.pack(&piece, &lattice);
            (piece.block.0, Arc::from(bytes))
        });
        let packed: Vec<(IVec3, Arc<[u8]>)> = packed.collect();
        self.shared.change(|state| state.put(packed));
    }

    /// Shows a whole surface, and what belongs to it, for good.
    pub fn show(&self, scene: &Scene, surface: &Surface<'_>) {
        let lattice = Lattice::of(surface.mesh);
        let heights = page::heights(surface, lattice.origin);
        let pieces = chunks::pieces(surface, &lattice);
        let packed = pieces.into_iter().zip(0..).map(|(piece, number)| {
            let mut bytes = Vec::new();
            piece.pack(&mut bytes);
            (IVec3::new(number, 0, 0), Arc::from(bytes))
        });
        let packed: Vec<_> = packed.collect();
        let channels = surface
            .paint
            .channels
            .iter()
            .map(|(channel, _)| channel.clone())
            .collect();
        self.shared.change(|state| {
            state.begin(lattice, false);
            state.paint(!surface.paint.colors.is_empty(), channels, heights);
            state.put(packed);
            state.path(&scene.path);
            state.figures(scene.figures.clone());
            state.end();
        });
    }

    /// Tells where the sensor was at all scans so far, world. Only what is new is sent, unless what was before changed.
    pub fn path(&self, places: &[DVec3]) {
        self.shared.change(|state| state.path(places));
    }

    /// Tells the place of one more scan, world, and how long it took, seconds.
    pub fn scan(&self, place: Option<DVec3>, seconds: f64) {
        self.shared.change(|state| state.scan(place, seconds));
    }

    /// Shows returns of the last scan, world, in place of those before.
    pub fn sweep(&self, returns: impl Iterator<Item = DVec3>) {
        let Some(lattice) = self.shared.look(State::lattice) else {
            return;
        };
        let mut bytes = Vec::new();
        for place in returns {
            let relative = (place - lattice.origin).as_vec3().to_array();
            bytes.extend_from_slice(relative.map(f32::to_le_bytes).as_flattened());
        }
        self.shared.change(|state| state.sweep(bytes.into()));
    }

    /// Tells which places of the path are one, since loops were closed there, world; in place of those before.
    pub fn loops(&self, ends: &[[DVec3; 2]]) {
        self.shared.change(|state| state.loops(ends));
    }

    /// Tells figures for people.
    pub fn figures(&self, figures: Vec<(String, String)>) {
        self.shared.change(|state| state.figures(figures));
    }

    /// Tells that nothing will change any more; viewers stay.
    pub fn end(&self) {
        self.shared.change(State::end);
    }
}

/// Packs pieces of blocks, in memory that it keeps.
#[derive(Default)]
struct Packer {
    steps: Vec<IVec3>,
    /// The number that each vertex has in the piece.
    numbers: Vec<u32>,
    piece: Piece,
    bytes: Vec<u8>,
}

impl Packer {
    /// The bytes of a piece; none of one without triangles.
    fn pack(&mut self, of: &tsdfuse::mesh::Piece<'_>, lattice: &Lattice) -> &[u8] {
        let Self {
            steps,
            numbers,
            piece,
            bytes,
        } = self;
        bytes.clear();
        if of.triangles.is_empty() {
            return bytes;
        }
        steps.clear();
        steps.extend(of.vertices.iter().map(|vertex| lattice.steps(*vertex)));
        numbers.clear();
        numbers.resize(steps.len(), u32::MAX);
        piece.origin = steps.iter().copied().reduce(IVec3::min).unwrap_or_default();
        piece.positions.clear();
        piece.normals.clear();
        piece.triangles.clear();
        let (origin, positions, normals) = (piece.origin, &mut piece.positions, &mut piece.normals);
        let mut renumber = |vertex: u32| {
            let vertex = vertex as usize;
            if numbers[vertex] == u32::MAX {
                numbers[vertex] = positions.len() as u32;
                positions.push((steps[vertex] - origin).to_array().map(|n| n as u16));
                normals.push(octahedral(normal(of.normals, vertex)));
            }
            numbers[vertex]
        };
        let triangles = of.triangles.iter().map(|corners| corners.map(&mut renumber));
        piece.triangles.extend(triangles);
        piece.pack(bytes);
        bytes
    }
}

fn normal(normals: &[Vec3], vertex: usize) -> Vec3 {
    normals.get(vertex).copied().unwrap_or(Vec3::Z)
}

#[cfg(test)]
mod tests;
