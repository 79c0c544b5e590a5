//! A run as a recording that Foxglove and RViz open: what was measured, where the sensor was, and the surface as it grew.

use std::collections::BTreeMap;
use std::path::Path;

use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::mesh::{Changes, Piece};
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

/// Writes a run as MCAP with ROS 2's standard messages, as its observer: each scan as `PointCloud2` with tf and `Odometry`, the surface
/// as markers (72 bytes a triangle) whenever it changed, and in the end an `OccupancyGrid` of what was free.
pub struct Recording {
    writer: Option<Writer>,
    stop: Stop,
    failed: Option<RunError>,
    occupancy: Occupancy,
    /// Pieces of the surface, by markers and blocks.
    pieces: BTreeMap<[i32; 3], BTreeMap<[i32; 3], Vec<DVec3>>>,
    heights_m: [f64; 2],
    last_ns: i64,
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
            writer: Some(Writer::create(path, &sensors)?),
            stop: stop.clone(),
            failed: None,
            occupancy: Occupancy::new(OccupancyConfig::default()).map_err(RunError::config)?,
            pieces: BTreeMap::new(),
            heights_m: [f64::INFINITY, f64::NEG_INFINITY],
            last_ns: 1_000_000_000,
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
        let Some(mut writer) = self.writer.take() else {
            return Ok(());
        };
        if let Some(slice) = self.occupancy.slice(self.heights_m[0], self.heights_m[1]) {
            let grid = OccupancyGrid {
                costs: slice.costs(0.0),
                origin: slice.origin,
                cell_m: slice.cell_m,
                width: slice.width,
            };
            writer.write_grid(self.last_ns, &grid)?;
        }
        Ok(writer.finish()?)
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
    fn take_in(&mut self, changes: &Changes) -> Vec<SurfacePart> {
        let mut changed: BTreeMap<[i32; 3], SurfacePart> = BTreeMap::new();
        for piece in changes.iter() {
            let block = piece.block.0;
            let place = block.div_euclid(IVec3::splat(MARKER_BLOCKS));
            let pieces = self.pieces.entry(place.to_array()).or_default();
            match piece.triangles.is_empty() {
                true => drop(pieces.remove(&block.to_array())),
                false => drop(pieces.insert(block.to_array(), corners(&piece))),
            }
            changed.entry(place.to_array()).or_insert(SurfacePart {
                place,
                corners: Vec::new(),
                colors: Vec::new(),
            });
        }
        for (place, part) in &mut changed {
            let pieces = self.pieces.get(place).into_iter().flat_map(BTreeMap::values);
            part.corners = pieces.flatten().copied().collect();
        }
        changed.into_values().collect()
    }
}

fn corners(piece: &Piece<'_>) -> Vec<DVec3> {
    let corner = |vertex: &u32| piece.vertices.get(*vertex as usize).copied().unwrap_or_default();
    piece.triangles.iter().flatten().map(corner).collect()
}

impl Observer for Recording {
    fn on(&mut self, event: Event<'_>) {
        match event {
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
                Ok(())
            }),
            Event::SurfaceChanged(changes) => self.try_to(|recording, writer| {
                let parts = recording.take_in(changes);
                Ok(writer.write_surface(recording.last_ns, &parts)?)
            }),
            _ => {}
        }
    }

    fn surface_share(&self) -> Option<f64> {
        Some(SHARE)
    }
}
