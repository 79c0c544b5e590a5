//! Saying what a map tells in messages: the surface as markers, free space as a grid, the sensor's way as odometry.

use tsdfuse::Pose;
use tsdfuse::glam::{DVec3, IVec3};

use super::writer::{Cdr, WORLD, Writer};
use crate::error::Result;
use crate::nav2::OccupancyGrid;

/// A part of a surface, which replaces the one that had its place before.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfacePart {
    /// Its place: parts with the same place replace each other.
    pub place: IVec3,
    /// Three corners of each triangle, world, metres; none where nothing is left.
    pub corners: Vec<DVec3>,
    /// The colour of each corner, sRGB; empty: all are grey.
    pub colors: Vec<[u8; 3]>,
}

/// Colour of a surface whose colours are not known.
const GREY: f32 = 0.75;

/// `visualization_msgs/Marker`: TRIANGLE_LIST, ADD, DELETE.
const TRIANGLE_LIST: i32 = 11;
const ADD: i32 = 0;
const DELETE: i32 = 2;

/// A message of parts of the surface has about so many bytes, and a surface no more than so many messages: fewer than wait for a slow
/// client.
const MESSAGE: usize = 4 << 20;
const MESSAGES: usize = 48;

const SURFACE: (&str, &str) = ("/surface", "visualization_msgs/MarkerArray");
const GRID: (&str, &str) = ("/map", "nav_msgs/OccupancyGrid");

impl Writer {
    /// Writes where the sensor was as `nav_msgs/Odometry` under `/odometry`.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn write_odometry(&mut self, time_ns: i64, pose: &Pose) -> Result<()> {
        let channel = self.channel("/odometry", "nav_msgs/Odometry")?;
        let mut message = Cdr::new();
        message.header(time_ns, WORLD);
        let frame = self.frame();
        message.text(&frame);
        message.pose(pose);
        // Covariances, and a twist, that are not known.
        for _ in 0..36 + 6 + 36 {
            message.number(0.0_f64.to_le_bytes());
        }
        self.write(channel, time_ns, message)
    }

    /// Writes where the sensor was, scan by scan, as `nav_msgs/Path` under `/path`.
    ///
    /// # Errors
    /// As [`Self::write_odometry`].
    pub fn write_path(&mut self, time_ns: i64, poses: &[Pose]) -> Result<()> {
        let channel = self.channel("/path", "nav_msgs/Path")?;
        let mut message = Cdr::new();
        message.header(time_ns, WORLD);
        message.u32(poses.len());
        for pose in poses {
            message.header(time_ns, WORLD);
            message.pose(pose);
        }
        self.write(channel, time_ns, message)
    }

    /// Makes the topics of the surface and of the grid known before there is anything to say.
    ///
    /// # Errors
    /// As [`Self::write_odometry`].
    pub fn announce(&mut self) -> Result<()> {
        for (topic, kind) in [SURFACE, GRID] {
            self.channel(topic, kind)?;
        }
        Ok(())
    }

    /// Whether somebody would see the surface; a file always does.
    pub fn is_surface_seen(&self) -> bool {
        self.known_channel(SURFACE.0)
            .is_none_or(|channel| self.is_heard(channel))
    }

    /// Whether somebody came who has not seen the surface so far.
    pub fn is_surface_new_to_some(&mut self) -> bool {
        let channel = self.known_channel(SURFACE.0);
        channel.is_some_and(|channel| self.has_newcomers(channel))
    }

    /// Writes parts of the surface as `visualization_msgs/MarkerArray` under `/surface`: lists of triangles.
    ///
    /// # Errors
    /// As [`Self::write_odometry`].
    pub fn write_surface(&mut self, time_ns: i64, parts: &[SurfacePart]) -> Result<()> {
        let channel = self.channel(SURFACE.0, SURFACE.1)?;
        let bytes_of = |part: &SurfacePart| 300 + 24 * part.corners.len() + 16 * part.colors.len();
        let bytes: usize = parts.iter().map(bytes_of).sum();
        let most = MESSAGE.max(bytes / MESSAGES);
        let mut left = parts;
        while !left.is_empty() {
            let mut bytes = 0;
            let fitting = left.iter().take_while(|part| {
                bytes += bytes_of(part);
                bytes <= most
            });
            let (now, later) = left.split_at(fitting.count().max(1));
            self.write(channel, time_ns, markers(time_ns, now))?;
            left = later;
        }
        Ok(())
    }

    /// Writes what is free and what is occupied, seen from above, as `nav_msgs/OccupancyGrid` under `/map`; unknown cells are −1.
    ///
    /// # Errors
    /// As [`Self::write_odometry`].
    pub fn write_grid(&mut self, time_ns: i64, grid: &OccupancyGrid) -> Result<()> {
        let channel = self.channel(GRID.0, GRID.1)?;
        let mut message = Cdr::new();
        message.header(time_ns, WORLD);
        message.time(time_ns);
        message.number((grid.cell_m as f32).to_le_bytes());
        message.u32(grid.width);
        message.u32(grid.costs.len() / grid.width.max(1));
        message.pose(&Pose {
            translation: grid.origin.extend(0.0),
            ..Pose::IDENTITY
        });
        message.u32(grid.costs.len());
        // The bits of −1.
        grid.costs.iter().for_each(|cost| message.byte(cost.unwrap_or(u8::MAX)));
        self.write(channel, time_ns, message)
    }
}

fn markers(time_ns: i64, parts: &[SurfacePart]) -> Cdr {
    let mut message = Cdr::new();
    message.u32(parts.len());
    for part in parts {
        let IVec3 { x, y, z } = part.place;
        message.header(time_ns, WORLD);
        message.text(&format!("surface {x} {y} {z}"));
        for value in [0, TRIANGLE_LIST, if part.corners.is_empty() { DELETE } else { ADD }] {
            message.number(value.to_le_bytes());
        }
        message.pose(&Pose::IDENTITY);
        (0..3).for_each(|_| message.number(1.0_f64.to_le_bytes()));
        message.color([GREY; 3]);
        // For ever, and not bound to a moving frame.
        message.u32(0);
        message.u32(0);
        message.byte(0);
        message.u32(part.corners.len());
        part.corners
            .iter()
            .flat_map(DVec3::to_array)
            .for_each(|value| message.number(value.to_le_bytes()));
        message.u32(part.colors.len());
        part.colors
            .iter()
            .for_each(|color| message.color(color.map(|c| f32::from(c) / 255.0)));
        // Texture, its image and coordinates, text, another mesh.
        message.text("");
        message.header(0, "");
        message.text("");
        message.u32(0);
        message.u32(0);
        message.text("");
        message.text("");
        message.text("");
        message.u32(0);
        message.byte(0);
    }
    message
}
