//! A scan as it is uploaded: its columns, and their description for kernels.

use std::borrow::Cow;
use std::f32::consts::TAU;
use std::ops::Range;

use rayon::prelude::*;
use tsdfuse::{
    Scan, SensorModel,
    fuse::{PatchConfig, twin},
    glam::{Vec2, Vec3},
    sensor::Pinhole,
};

use crate::frame::Frame;
use crate::sweep::Segment;

/// A scan as it is uploaded.
pub(crate) struct Prepared<'a> {
    pub(crate) scan: &'a Scan,
    /// The most that each [`PART`] of the returns can add to the weight of one voxel.
    pub(crate) weights: Vec<f32>,
    /// The number of returns, or of pixels.
    pub(crate) items: usize,
    /// The motion of the sensor; empty if all returns are placed from the scan's pose.
    pub(crate) segments: Vec<Segment>,
    pub(crate) image: Option<Image<'a>>,
    pub(crate) surface: Option<Surface<'a>>,
    pub(crate) cylinder: Option<&'a Cylinder>,
    pub(crate) camera: Option<Pinhole>,
}

/// The inputs of the organized image of a scan.
pub(crate) struct Image<'a> {
    /// The ring of each return.
    pub(crate) rings: Cow<'a, [u16]>,
    pub(crate) size: [u32; 2],
    pub(crate) max_range_m: f32,
    pub(crate) min_dot: f32,
}

/// What surface patches need besides the image.
pub(crate) struct Surface<'a> {
    pub(crate) config: PatchConfig,
    /// The tangents of the angles between rings.
    pub(crate) gaps: &'a [f32],
    /// The nearest ring for each bin of elevation.
    pub(crate) nearest: &'a [u32],
    /// How many patches meet in a voxel of 1 m that faces the sensor 1 m away; 0 if the map is not looked at.
    pub(crate) crowd: f32,
    /// How many cells apart neighbours may be: see [`Rows`](tsdfuse::fuse::Rows).
    pub(crate) neighbour_cells: u32,
}

/// The cylindrical image of a sensor, for a phase of 0.
#[derive(Debug)]
pub(crate) struct Cylinder {
    size: [u32; 2],
    /// The tangent of row 0.
    top: f32,
    /// Height of a row (as a tangent) and width of a column (radians).
    pitch: f32,
    /// Unit vectors in the horizontal plane towards each column.
    towards: Vec<Vec2>,
}

/// How many returns share one sum of weights.
const PART: usize = 4096;

/// The sums of the returns' weights, one for each [`PART`]; a weight follows from the range.
pub(crate) fn weights(points: &[Vec3], weigh: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    let of_part = |part: &[Vec3]| part.iter().map(|p| weigh(p.length())).sum();
    points.par_chunks(PART).map(of_part).collect()
}

/// The sums of weights by (5.8).
pub(crate) fn range_weights(points: &[Vec3]) -> Vec<f32> {
    weights(points, |range_m| (1.0 / range_m).min(1.0))
}

/// Groups the parts of `all` returns into pieces of at most `most_returns` returns and at most `most_weight` each.
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

impl<'a> Image<'a> {
    /// The image of a sensor.
    pub(crate) fn of(sensor: &SensorModel, rings: Cow<'a, [u16]>) -> Self {
        Self {
            rings,
            size: [sensor.rings() as u32, sensor.columns],
            max_range_m: sensor.max_range_m,
            min_dot: 0.0,
        }
    }
}

impl Cylinder {
    /// The cylindrical image of a sensor.
    pub(crate) fn of(sensor: &SensorModel) -> Self {
        let image = twin::cylindrical_image(sensor, 0.0);
        let center = |column| image.unproject(0, column, 1.0);
        Self {
            size: [image.rows() as u32, image.columns() as u32],
            top: center(0).z,
            pitch: image.pitch(),
            towards: (0..image.columns()).map(|column| center(column).truncate()).collect(),
        }
    }

    /// Upper bounds of the returns' weights (5.8): the centre of a pixel can be nearer than its return, by half a diagonal.
    pub(crate) fn weights(&self, points: &[Vec3]) -> Vec<f32> {
        weights(points, |range_m| 1.0 / (range_m * (1.0 - self.pitch)).max(1.0))
    }
}

/// The most lines between two returns that update one voxel. Two lines are at least ¾ voxel apart, three at least 9/8, and they
/// reach 1.73 voxels.
const MOST_BETWEEN: f32 = 4.0;

impl Surface<'_> {
    /// Upper bounds of what returns add to a voxel: each return itself, and the links to two neighbours.
    pub(crate) fn weights(&self, scan: &Scan) -> Vec<f32> {
        // A patch can be this much nearer to the scan's position than its return is to the position that it was measured from.
        let off_m = twin::MAX_OFF * (self.config.noise_m.max(twin::NOISE_M[1]) + twin::ROUGHNESS_M);
        let shift_m = largest_shift_m(scan);
        let each = 1.0 + 2.0 * MOST_BETWEEN;
        weights(&scan.points, |range_m| {
            // The other end of a link can be nearer, and the middle of the link nearer still: by Pythagoras.
            let half_gap = 0.5 * twin::MAX_GAP_OF_RANGE;
            let of_middle_m = range_m / (1.0 + twin::MAX_GAP_OF_RANGE) * (1.0 - half_gap * half_gap).sqrt();
            each / (of_middle_m - off_m - shift_m).max(1.0)
        })
    }
}

/// The largest distance of the sensor from the scan's position while it measured the returns, metres.
fn largest_shift_m(scan: &Scan) -> f32 {
    let Some(sweep) = scan.sweep() else { return 0.0 };
    let times = scan.times.iter().flatten().copied().filter(|t| t.is_finite());
    let (first, last) = times.fold((0.0_f32, 0.0_f32), |(first, last), t| (first.min(t), last.max(t)));
    let (first, last) = (f64::from(first), f64::from(last));
    // Along a straight line the distance is largest at one of its ends.
    let ends = sweep
        .knots()
        .filter(|knot| (first..last).contains(knot))
        .chain([first, last]);
    ends.map(|secs| sweep.relative_at(secs).1.length() as f32)
        .fold(0.0, f32::max)
}

impl Prepared<'_> {
    /// The columns that are uploaded: points; times and motion if returns are placed by them; the sensor's angles; rings.
    pub(crate) fn columns(&self) -> Vec<&[u8]> {
        let mut columns = vec![
            bytemuck::cast_slice(&self.scan.points),
            bytemuck::cast_slice(self.times()),
            bytemuck::cast_slice(&self.segments),
        ];
        if let Some(Surface { gaps, nearest, .. }) = &self.surface {
            columns.extend([bytemuck::cast_slice(gaps), bytemuck::cast_slice(nearest)]);
        }
        if let Some(cylinder) = self.cylinder {
            columns.push(bytemuck::cast_slice(&cylinder.towards));
        }
        if let Some(image) = &self.image {
            columns.push(bytemuck::cast_slice(&image.rings));
        }
        columns
    }

    /// Enters the offsets of these columns into a frame.
    pub(crate) fn place_columns(&self, frame: &mut Frame) {
        frame.total = self.scan.points.len() as u32;
        let mut next = 3 * self.scan.points.len();
        let mut place = |column: usize| {
            next += column;
            (next - column) as u32
        };
        if !self.times().is_empty() {
            frame.times_at = place(self.times().len());
        }
        frame.segments_at = place(self.segments.len() * size_of::<Segment>() / 4);
        frame.segments = self.segments.len() as u32;
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
            frame.neighbour_cells = surface.neighbour_cells;
            frame.step_m = twin::STEP / frame.voxels_per_m;
            frame.crowd = surface.crowd / (frame.voxels_per_m * frame.voxels_per_m);
        }
        if let Some(camera) = self.camera {
            frame.camera = [camera.fx, camera.fy, camera.cx, camera.cy];
            [frame.rings, frame.columns] = [camera.height, camera.width];
        }
        if let Some(cylinder) = self.cylinder {
            frame.towards_at = place(2 * cylinder.towards.len());
            [frame.rings, frame.columns] = cylinder.size;
            (frame.top, frame.column_rad) = (cylinder.top, cylinder.pitch);
            frame.columns_per_rad = frame.columns as f32 / TAU;
            frame.per_pitch = 1.0 / cylinder.pitch;
        }
        if let Some(image) = &self.image {
            frame.rings_at = place(image.rings.len().div_ceil(2));
            [frame.rings, frame.columns] = image.size;
            frame.columns_per_rad = frame.columns as f32 / TAU;
            frame.column_rad = (std::f64::consts::TAU / f64::from(frame.columns)) as f32;
            (frame.max_range_m, frame.min_dot) = (image.max_range_m, image.min_dot);
        }
    }

    /// The sizes of the further buffers that its kernels use, in bytes: see [`Scratch`](crate::scratch::Scratch).
    pub(crate) fn scratch(&self) -> Vec<u64> {
        let returns = self.scan.points.len() as u64;
        if let Some(camera) = self.camera {
            return vec![0, 0, 4 * (camera.pixels() as u64 + 1)];
        }
        if let Some(cylinder) = self.cylinder {
            let pixels: u64 = cylinder.size.map(u64::from).iter().product();
            return vec![0, SEEN_BYTES * returns, 8 * pixels, RING_BYTES];
        }
        let Some(Image {
            size: [rings, columns], ..
        }) = self.image
        else {
            return Vec::new();
        };
        let rings = u64::from(rings);
        let cells = rings * u64::from(columns);
        let mut bytes = vec![
            CELL_BYTES * cells,
            PLACE_BYTES * returns,
            OFFER_BYTES * cells,
            RING_BYTES * rings,
        ];
        if self.surface.is_some() {
            bytes.extend([
                PATCH_BYTES * cells,
                4 * (1 + twin::ARMS as u64 + returns.div_ceil(twin::SAMPLE as u64)),
            ]);
        }
        bytes
    }

    fn times(&self) -> &[f32] {
        let times = self.scan.times.as_deref().filter(|_| !self.segments.is_empty());
        times.unwrap_or(&[])
    }
}

/// Sizes of the kernels' structs.
pub(crate) const CELL_BYTES: u64 = 16;
pub(crate) const PLACE_BYTES: u64 = 8;
pub(crate) const SEEN_BYTES: u64 = 8;
pub(crate) const OFFER_BYTES: u64 = 12;
pub(crate) const RING_BYTES: u64 = 132;
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

    #[test]
    fn centers_of_pixels_weigh_no_more_than_was_thought() {
        for columns in [6, 40, 1800] {
            let sensor = SensorModel::from_beams("few", vec![-60.0, 0.0, 50.0], columns, (0.1, 100.0)).unwrap();
            let (image, cylinder) = (twin::cylindrical_image(&sensor, 0.0), Cylinder::of(&sensor));
            let mut heavier = 0;
            for i in 0..5000_u16 {
                let f = f32::from(i);
                let p = Vec3::new((0.7 * f).sin(), (0.7 * f).cos(), 2.5 * (1.3 * f).sin()) * (0.9 + 0.001 * f);
                let seen = image.project(p);
                let Some((row, column)) = image.pixel(seen) else {
                    continue;
                };
                let center = image.unproject(row, column, seen.depth_m);
                let weight = range_weights(&[center])[0];
                assert!(weight <= cylinder.weights(&[p])[0], "{p} {center}");
                heavier += usize::from(weight > range_weights(&[p])[0]);
            }
            assert!(heavier > 500, "{heavier}");
        }
    }
}
