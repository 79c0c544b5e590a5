//! A run in the messages that Foxglove and RViz know, recorded or served: what was measured, where the sensor was, and the surface as it
//! grows.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tsdfuse::Pose;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::mesh::Piece;
use tsdfuse_io::nav2::OccupancyGrid;
use tsdfuse_io::ros::{SurfacePart, Writer};
use tsdfuse_io::{Log, Sensor};
use tsdfuse_plan::{Occupancy, OccupancyConfig};

use crate::error::{Result, RunError};
use crate::event::{Event, Observer, Stop};

/// The share of the time that may be spent on the surface.
const SHARE: f64 = 0.25;

/// Obstacles of the grid are between these heights below and above the sensor, metres.
const HEIGHTS_M: [f64; 2] = [-1.2, 0.5];

/// Blocks of a map along the edge of what is one marker.
const MARKER_BLOCKS: i32 = 8;

/// From grid to grid that is told while the run goes on, at least; and so many times as long as the last one took.
const GRID_PAUSE: Duration = Duration::from_secs(1);
const GRID_REST: u32 = 20;

/// Tells a run in ROS 2's standard messages, as its observer: each scan as `PointCloud2` with tf and `Odometry`, the surface
/// as markers (72 bytes a triangle) whenever it changed, and an `OccupancyGrid` of what was free: into an MCAP file (the grid in the end), or to the
/// clients of a server.
pub struct Recording {
    writer: Option<Writer>,
    /// The file, if it is one, and the sensor.
    file: Option<(PathBuf, Vec<Sensor>)>,
    stop: Stop,
    failed: Option<RunError>,
    occupancy: Occupancy,
    /// Pieces of the surface, by markers and blocks.
    pieces: BTreeMap<[i32; 3], BTreeMap<[i32; 3], Vec<DVec3>>>,
    heights_m: [f64; 2],
    last_ns: i64,
    /// When the grid is told next, before the end.
    next_grid: Option<Instant>,
}

impl Recording {
    /// Begins a file for a run on a log; where it cannot be written, the run is stopped.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn create(path: &Path, log: &Log, stop: &Stop) -> Result<Self> {
        // Which sensor a scan is of does not matter any more once it is placed.
        let sensors: Vec<Sensor> = log.sensors().iter().take(1).cloned().collect();
        Ok(Self {
            file: Some((path.to_owned(), sensors.clone())),
            ..Self::to(Writer::create(path, &sensors)?, stop)?
        })
    }

    /// Tells the clients of a server: who comes late, is told all of the surface.
    ///
    /// # Errors
    /// Names the server and what is wrong.
    #[cfg(feature = "serve")]
    pub fn serve(server: &tsdfuse_io::ros::Server, stop: &Stop) -> Result<Self> {
        let writer = Writer::to(server, &[Sensor::new("lidar")])?;
        Ok(Self {
            next_grid: Some(Instant::now()),
            ..Self::to(writer, stop)?
        })
    }

    fn to(mut writer: Writer, stop: &Stop) -> Result<Self> {
        writer.announce()?;
        Ok(Self {
            writer: Some(writer),
            file: None,
            stop: stop.clone(),
            failed: None,
            occupancy: Occupancy::new(OccupancyConfig::default()).map_err(RunError::config)?,
            pieces: BTreeMap::new(),
            heights_m: [f64::INFINITY, f64::NEG_INFINITY],
            last_ns: 1_000_000_000,
            next_grid: None,
        })
    }

    /// Completes the file.
    ///
    /// # Errors
    /// What went wrong on the way, or as [`Self::create`].
    pub fn finish(mut self) -> Result<()> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        Ok(writer.finish()?)
    }

    /// Tells a surface, piece by piece, each in place of what its block had before.
    pub fn show<'a>(&mut self, pieces: impl Iterator<Item = Piece<'a>>) {
        self.try_to(|recording, writer| {
            let parts = recording.take_in(pieces);
            Ok(writer.write_surface(recording.last_ns, &parts)?)
        });
    }

    /// Tells where the sensor was.
    pub fn path(&mut self, poses: &[Pose]) {
        self.try_to(|recording, writer| Ok(writer.write_path(recording.last_ns, poses)?));
    }

    /// Tells the surface to who came since this was called last. A run does so by itself until it is done.
    pub fn attend(&mut self) {
        self.try_to(|recording, writer| {
            if writer.is_surface_new_to_some() {
                let parts: Vec<SurfacePart> = recording.pieces.keys().map(|place| recording.part(*place)).collect();
                writer.write_surface(recording.last_ns, &parts)?;
            }
            Ok(())
        });
    }

    /// A stream that is over is fused again: a file begins again, too; clients of a server are told what is new in place of what was.
    fn begin_again(&mut self) {
        self.try_to(|recording, writer| {
            recording.occupancy = Occupancy::new(OccupancyConfig::default()).map_err(RunError::config)?;
            recording.heights_m = [f64::INFINITY, f64::NEG_INFINITY];
            if let Some((path, sensors)) = &recording.file {
                recording.pieces.clear();
                *writer = Writer::create(path, sensors)?;
                writer.announce()?;
            }
            Ok(())
        });
    }

    fn tell_grid(&self, writer: &mut Writer) -> Result<()> {
        if let Some(slice) = self.occupancy.slice(self.heights_m[0], self.heights_m[1]) {
            let grid = OccupancyGrid {
                costs: slice.costs(0.0),
                origin: slice.origin,
                cell_m: slice.cell_m,
                width: slice.width,
            };
            writer.write_grid(self.last_ns, &grid)?;
        }
        Ok(())
    }

    fn try_to(&mut self, write: impl FnOnce(&mut Self, &mut Writer) -> Result<()>) {
        let Some(mut writer) = self.writer.take() else { return };
        match write(self, &mut writer) {
            Ok(()) => self.writer = Some(writer),
            Err(error) => {
                self.failed = Some(error);
                self.stop.stop();
            }
        }
    }

    /// The markers of which pieces changed.
    fn take_in<'a>(&mut self, changed: impl Iterator<Item = Piece<'a>>) -> Vec<SurfacePart> {
        let mut places = BTreeSet::new();
        for piece in changed {
            let block = piece.block.0;
            let place = block.div_euclid(IVec3::splat(MARKER_BLOCKS)).to_array();
            places.insert(place);
            let pieces = self.pieces.entry(place).or_default();
            if piece.triangles.is_empty() {
                pieces.remove(&block.to_array());
            } else {
                pieces.insert(block.to_array(), corners(&piece));
            }
        }
        places.into_iter().map(|place| self.part(place)).collect()
    }

    /// A marker as it is now.
    fn part(&self, place: [i32; 3]) -> SurfacePart {
        let pieces = self.pieces.get(&place).into_iter().flat_map(BTreeMap::values);
        SurfacePart {
            place: place.into(),
            corners: pieces.flatten().copied().collect(),
            colors: Vec::new(),
        }
    }
}

fn corners(piece: &Piece<'_>) -> Vec<DVec3> {
    let corner = |vertex: &u32| piece.vertices.get(*vertex as usize).copied().unwrap_or_default();
    piece.triangles.iter().flatten().map(corner).collect()
}

impl Observer for Recording {
    fn on(&mut self, event: Event<'_>) {
        match event {
            Event::Begun { .. } => self.begin_again(),
            Event::ScanRead { scan, .. } => self.try_to(|recording, writer| {
                let time_ns = writer.time_ns(scan);
                recording.last_ns = time_ns;
                writer.write_scan(0, scan)?;
                if let Some(pose) = scan.pose {
                    writer.write_odometry(time_ns, &pose)?;
                    let [low, high] = HEIGHTS_M.map(|height| pose.translation.z + height);
                    recording.heights_m = [recording.heights_m[0].min(low), recording.heights_m[1].max(high)];
                    recording.occupancy.integrate(scan).map_err(RunError::config)?;
                }
                if recording.next_grid.is_some_and(|next| next <= Instant::now()) {
                    let begun = Instant::now();
                    recording.tell_grid(writer)?;
                    recording.next_grid = Some(Instant::now() + GRID_PAUSE.max(begun.elapsed() * GRID_REST));
                }
                Ok(())
            }),
            Event::SurfaceChanged(changes) => self.show(changes.iter()),
            // Whoever came is told all of it.
            Event::ScanFused { .. } => self.attend(),
            Event::Done { .. } => self.try_to(|recording, writer| recording.tell_grid(writer)),
            _ => {}
        }
    }

    fn surface_share(&self) -> Option<f64> {
        let is_seen = self.writer.as_ref().is_some_and(Writer::is_surface_seen);
        Some(if is_seen { SHARE } else { 0.0 })
    }
}
