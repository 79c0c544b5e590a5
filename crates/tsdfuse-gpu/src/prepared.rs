//! A scan as it is sent: its columns, and what kernels are told of them.

use std::borrow::Cow;
use std::ops::Range;

use rayon::prelude::*;
use tsdfuse::{
    Scan,
    fuse::{PatchConfig, Skipped, twin},
    glam::Vec3,
    sensor::{NONE, Pinhole, ScanImage},
};

use crate::frame::Frame;

/// A scan as it is sent.
pub(crate) struct Prepared<'a> {
    pub(crate) scan: Cow<'a, Scan>,
    /// What was left out on the way.
    pub(crate) skipped: Skipped,
    /// The most that returns can add to the weight of one voxel: of each [`PART`] of them.
    pub(crate) weights: Vec<f32>,
    /// Returns, or pixels.
    pub(crate) items: usize,
    pub(crate) image: Option<Image>,
    pub(crate) surface: Option<Surface<'a>>,
    pub(crate) depth: Option<(Pinhole, &'a [f32])>,
}

/// An organized image as it is sent.
#[derive(Default)]
pub(crate) struct Image {
    /// The cell of each return, row by row, or [`NONE`].
    cell_of: Vec<u32>,
    /// The return in each cell, or [`NONE`].
    cells: Vec<u32>,
    rings: u32,
    columns: u32,
    pub(crate) max_range_m: f32,
    pub(crate) min_dot: f32,
}

/// What surface patches need beside the image.
pub(crate) struct Surface<'a> {
    pub(crate) config: PatchConfig,
    /// Tangents of the angles between rings.
    pub(crate) gaps: Vec<f32>,
    pub(crate) column_rad: f32,
    /// The nearest ring of each bin of elevation.
    pub(crate) nearest: &'a [u32],
}

/// Returns whose weights are summed up together.
const PART: usize = 4096;

/// Sums of what returns weigh by their range, in parts.
pub(crate) fn weights(points: &[Vec3], weigh: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    let of_part = |part: &[Vec3]| part.iter().map(|p| weigh(p.length())).sum();
    points.par_chunks(PART).map(of_part).collect()
}

/// Those of weights (5.8).
pub(crate) fn range_weights(points: &[Vec3]) -> Vec<f32> {
    weights(points, |range_m| (1.0 / range_m).min(1.0))
}

/// Cuts parts of returns, `all` of them, into pieces of at most `most_returns` that add no more than `most_weight` each.
pub(crate) fn pieces(weights: &[f32], all: usize, most_returns: usize, most_weight: f32) -> Vec<Range<usize>> {
    let mut pieces: Vec<Range<usize>> = Vec::new();
    let mut sum = 0.0;
    for (first, weight) in (0..).step_by(PART).zip(weights) {
        let end = all.min(first + PART);
        sum += weight;
        match pieces.last_mut() {
            Some(last) if sum <= most_weight && end - last.start <= most_returns => last.end = end,
            _ => {
                pieces.push(first..end);
                sum = *weight;
            }
        }
    }
    pieces
}

impl Image {
    /// That of so many returns.
    pub(crate) fn of(image: &ScanImage, returns: usize) -> Self {
        let cell = |(ring, column)| (ring * image.columns() + column) as u32;
        Self {
            cell_of: (0..returns).map(|i| image.place_of(i).map_or(NONE, cell)).collect(),
            cells: (0..image.rings()).flat_map(|ring| image.row(ring)).copied().collect(),
            rings: image.rings() as u32,
            columns: image.columns() as u32,
            ..Self::default()
        }
    }
}

/// Lines between two returns that may update one voxel: they are at least ¾ voxel apart where there are two, 9/8 where there are
/// three, and reach 1.73 voxels.
const MOST_BETWEEN: f32 = 4.0;

impl Surface<'_> {
    /// The most that returns add to a voxel: each for itself, and what lies between it and two others.
    pub(crate) fn weights(&self, scan: &Scan) -> Vec<f32> {
        // How much nearer to the sensor's position these may be than returns are to where they were measured from.
        let off_m = twin::MAX_OFF * (self.config.noise_m.max(twin::NOISE_M[1]) + twin::ROUGHNESS_M);
        let latest_secs = scan
            .times
            .iter()
            .flatten()
            .fold(0.0_f32, |latest, t| latest.max(t.abs()));
        let shift_m = scan.trajectory().map_or(0.0, |trajectory| {
            trajectory.relative_at(f64::from(latest_secs)).1.length() as f32
        });
        let nearer_m = off_m + shift_m + self.config.max_gap_m;
        let each = 1.0 + 2.0 * MOST_BETWEEN * twin::BETWEEN_WEIGHT;
        weights(&scan.points, |range_m| each / (range_m - nearer_m).max(1.0))
    }
}

impl Prepared<'_> {
    /// What is sent: points, times if returns are placed by them, then the image; of a depth image its depths alone.
    pub(crate) fn columns(&self) -> Vec<&[u8]> {
        if let Some((_, depths)) = &self.depth {
            return vec![bytemuck::cast_slice(depths)];
        }
        let mut columns = vec![
            bytemuck::cast_slice(&self.scan.points),
            bytemuck::cast_slice(self.times()),
        ];
        if let Some(image) = &self.image {
            columns.extend([bytemuck::cast_slice(&image.cell_of), bytemuck::cast_slice(&image.cells)]);
        }
        if let Some(surface) = &self.surface {
            columns.extend([
                bytemuck::cast_slice(&surface.gaps),
                bytemuck::cast_slice(surface.nearest),
            ]);
        }
        columns
    }

    /// Tells kernels where these columns begin.
    pub(crate) fn place_columns(&self, frame: &mut Frame) {
        if let Some((camera, depths)) = &self.depth {
            frame.camera = [camera.fx, camera.fy, camera.cx, camera.cy];
            (frame.columns, frame.rings) = (camera.width, camera.height);
            frame.max_range_m = depths.iter().copied().fold(0.0, f32::max);
            return;
        }
        frame.total = self.scan.points.len() as u32;
        let mut next = 3 * self.scan.points.len();
        let mut place = |column: usize| {
            next += column;
            (next - column) as u32
        };
        if !self.times().is_empty() {
            frame.times_at = place(self.times().len());
        }
        if let Some(image) = &self.image {
            frame.cells_at = place(image.cell_of.len());
            frame.image_at = place(image.cells.len());
            (frame.rings, frame.columns) = (image.rings, image.columns);
            (frame.max_range_m, frame.min_dot) = (image.max_range_m, image.min_dot);
        }
        if let Some(surface) = &self.surface {
            frame.gaps_at = place(surface.gaps.len());
            frame.nearest_at = place(surface.nearest.len());
            let PatchConfig {
                window_m,
                noise_m,
                max_gap_m,
                ..
            } = surface.config;
            (frame.window_m, frame.noise_m, frame.max_gap_m) = (window_m, noise_m, max_gap_m);
            frame.step_m = twin::STEP / frame.voxels_per_m;
            frame.column_rad = surface.column_rad;
        }
    }

    /// Bytes of the buffers beside the scan that its kernels use: placed cells, patches, noise.
    pub(crate) fn scratch(&self) -> Vec<u64> {
        let Some((image, _)) = self.image.as_ref().zip(self.surface.as_ref()) else {
            return Vec::new();
        };
        let cells = u64::from(image.rings) * u64::from(image.columns);
        let samples = self.scan.points.len().div_ceil(twin::SAMPLE) as u64;
        vec![CELL_BYTES * cells, PATCH_BYTES * cells, 4 * (1 + samples)]
    }

    fn times(&self) -> &[f32] {
        self.scan.trajectory().and(self.scan.times.as_deref()).unwrap_or(&[])
    }
}

/// Of `Cell` and `Patch` in the kernels.
pub(crate) const CELL_BYTES: u64 = 16;
pub(crate) const PATCH_BYTES: u64 = 32;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_as_long_as_they_may_be() {
        let weights = [3.0, 3.0, 5.0, 1.0, 7.0];
        let all = 4 * PART + 5;
        let cut = |most_parts: usize, most| pieces(&weights, all, most_parts * PART, most);
        assert_eq!(cut(9, 100.0).as_slice(), std::slice::from_ref(&(0..all)));
        assert_eq!(cut(9, 7.0), [0..2 * PART, 2 * PART..4 * PART, 4 * PART..all]);
        assert_eq!(cut(2, 100.0), [0..2 * PART, 2 * PART..4 * PART, 4 * PART..all]);
        assert_eq!(pieces(&[], 0, PART, 1.0), []);
    }
}
