//! How strongly a surface reflects: intensities of returns, averaged in a layer of voxels beside the map.
//!
//! Where voxels of a map hold a distance over the truncation, f ∈ [−1, 1], those of the layer hold an intensity I, measured against a
//! scale I₀:
//!
//! ```text
//!   f = 2·I / (I + I₀) − 1,     I = I₀·(1 + f) / (1 − f)
//! ```
//!
//! f grows ever more slowly, so a mean of it is hardly moved by a few glints.
//!
//! Returns are corrected for the angle at which they hit (Lambert), and for the range: sensors differ in how much of that they do
//! themselves, so it is learnt from surface that is seen again from elsewhere ([`RangeResponse`]).

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tsdfuse::glam::DVec3;
use tsdfuse::{MapConfig, Scan, VoxelMap};
use tsdfuse_view::{Channel, Ramp};

use crate::error::{Result, RunError};
use crate::layer::{Layer, path_beside};

/// I₀: between the intensities of asphalt and of paint, where sensors count to 255.
const SCALE: f32 = 50.0;

/// Less than this is taken for the cosine of the incidence: where it is smaller, it is not known well.
const LEAST_COS: f32 = 0.25;

/// Of so many vertices or voxels, the brightest ones are not shown brighter than [`BRIGHT`] of all.
const SAMPLES: usize = 100_000;
/// See [`SAMPLES`].
const BRIGHT: f32 = 0.97;

/// The intensity that f stands for.
pub(crate) fn decode(f: f32) -> f32 {
    let f = f.min(0.999);
    SCALE * (1.0 + f) / (1.0 - f)
}

fn encode(intensity: f32) -> f32 {
    2.0 * intensity / (intensity + SCALE) - 1.0
}

/// How much stronger a sensor reports the same surface at some ranges than at others.
///
/// Each return of surface that was seen before tells by how much its intensity differs from the mean so far. For each range, the mean of
/// these (of their logarithms, glints cut off) is taken back from later returns; over all ranges they are 1 in the mean.
#[derive(Clone, Debug)]
pub struct RangeResponse {
    /// Logarithms of the factors, of ranges from 2^(i/[`PER_OCTAVE`]) m on.
    logs: [f32; BINS],
    /// Returns that told them.
    seen: [f64; BINS],
}

/// Ranges from 1 m to 256 m, so many to twice the range.
const PER_OCTAVE: f32 = 4.0;
const BINS: usize = 33;

/// Returns after which a factor is as good as it gets, and at which it is half believed.
const ENOUGH: f64 = 20_000.0;

/// Factors from this to its inverse are possible.
const MOST_LOG: f32 = 1.6;

impl Default for RangeResponse {
    fn default() -> Self {
        Self {
            logs: [0.0; BINS],
            seen: [0.0; BINS],
        }
    }
}

impl RangeResponse {
    fn bin(range_m: f32) -> usize {
        // A conversion saturates.
        ((PER_OCTAVE * range_m.log2()) as usize).min(BINS - 1)
    }

    /// By how much stronger than on average a surface is reported at a range.
    pub fn at(&self, range_m: f32) -> f32 {
        self.logs[Self::bin(range_m)].exp()
    }

    /// Learns from returns: their ranges, and the logarithms of how much stronger they are, after correction, than the surface so far.
    fn learn(&mut self, returns: impl IntoIterator<Item = (f32, f32)>) {
        let mut sums = [(0.0_f64, 0.0_f64); BINS];
        for (range_m, off) in returns {
            let (sum, count) = &mut sums[Self::bin(range_m)];
            (*sum, *count) = (*sum + f64::from(off.clamp(-1.0, 1.0)), *count + 1.0);
        }
        for (i, (sum, count)) in sums.into_iter().enumerate().filter(|(_, (_, count))| *count > 0.0) {
            self.seen[i] += count;
            let share = (count / self.seen[i].clamp(1.0, ENOUGH)).min(0.5);
            self.logs[i] = (self.logs[i] + (share * sum / count) as f32).clamp(-MOST_LOG, MOST_LOG);
        }
        // What is the same at all ranges is the surface's own.
        let weight: f64 = self.seen.iter().sum();
        let mean = self
            .logs
            .iter()
            .zip(&self.seen)
            .map(|(log, seen)| f64::from(*log) * seen)
            .sum::<f64>()
            / weight.max(1.0);
        let known = self.logs.iter_mut().zip(&self.seen).filter(|(_, seen)| **seen > 0.0);
        known.for_each(|(log, _)| *log -= mean as f32);
    }
}

/// Intensities of the surface of a map.
#[derive(Debug)]
pub struct Intensity {
    layer: Layer,
    response: RangeResponse,
}

impl Intensity {
    /// A layer without observations beside a map.
    ///
    /// # Errors
    /// As [`VoxelMap::new`].
    pub fn beside(map: &MapConfig) -> Result<Self> {
        Ok(Self {
            layer: Layer::beside(map)?,
            response: RangeResponse::default(),
        })
    }

    /// The file of the layer beside that of a map: `street.tsdf` has `street.intensity.tsdf`.
    pub fn path_beside(map: &Path) -> PathBuf {
        path_beside(map, "intensity")
    }

    /// Reads a layer.
    ///
    /// # Errors
    /// As [`tsdfuse_io::map_file::read`]; [`RunError::Config`] for a map that is no such layer.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self {
            layer: Layer::read(path)?,
            response: RangeResponse::default(),
        })
    }

    /// Saves the layer as a map file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        self.layer.save(path)
    }

    /// Saves the layer beside a store that is about to be committed with so many scans. Until [`Self::committed`], that of the
    /// commit before stays: whichever of both a crash leaves valid, it is there.
    pub(crate) fn save_before_commit(&mut self, store: &Path, done: usize) -> Result<()> {
        self.layer.set_scans(done);
        self.layer.save(&path_beside(store, "intensity-next"))
    }

    /// The store was committed.
    pub(crate) fn committed(store: &Path) -> Result<()> {
        let next = path_beside(store, "intensity-next");
        Ok(std::fs::rename(&next, Self::path_beside(store)).map_err(tsdfuse_io::Error::io(&next))?)
    }

    /// Reads the layer of a store that was committed with so many scans.
    pub(crate) fn read_beside_store(store: &Path, done: usize) -> Result<Self> {
        for name in ["intensity", "intensity-next"] {
            let path = path_beside(store, name);
            if path.is_file() {
                let layer = Self::read(&path)?;
                if layer.layer.scans() == done {
                    return Ok(layer);
                }
            }
        }
        let path = Self::path_beside(store);
        Err(RunError::config(format_args!(
            "{}: the intensities of the {done} scans in the store are not there",
            path.display()
        )))
    }

    /// Bytes of its blocks.
    pub fn memory_bytes(&self) -> usize {
        self.layer.memory_bytes()
    }

    /// What was learnt of the sensor.
    pub fn response(&self) -> &RangeResponse {
        &self.response
    }

    pub(crate) fn layer(&self) -> &Layer {
        &self.layer
    }

    /// Adds a scan that is in `map`; whether it has intensities. Each return counts for the voxel that it lies in, as it would look from
    /// straight ahead (Lambert) at a middle range, the less the flatter it hit: weighted by the cosine of the incidence. That comes from
    /// the map's gradient. `map` may be the part of a map that the scan has reached.
    ///
    /// # Errors
    /// [`RunError::Full`] if there is no memory for it.
    pub fn add(&mut self, map: &VoxelMap, scan: &Scan) -> Result<bool> {
        let (Some(intensities), Ok(points), Ok(poses)) = (&scan.intensities, scan.points_in_world(), scan.poses())
        else {
            return Ok(false);
        };
        let returns: Vec<(DVec3, DVec3)> = points
            .zip(poses)
            .map(|(point, pose)| (point, pose.translation))
            .collect();
        struct Corrected {
            point: DVec3,
            range_m: f32,
            intensity: f32,
            weight: f32,
            /// The logarithm of how much stronger it is than what was there.
            off: Option<f32>,
        }
        let correct = |(&(point, eye), &intensity): (&(DVec3, DVec3), &f32)| {
            if !(intensity >= 0.0 && intensity.is_finite()) {
                return None;
            }
            let gradient = map.sample(point).map(|sample| sample.gradient.normalize_or_zero());
            let way = (eye - point).as_vec3();
            let range_m = way.length();
            // Where the map knows no direction, the return counts as one of mean incidence.
            let cos = gradient
                .map_or(0.7, |normal| normal.dot(way / range_m).abs())
                .max(LEAST_COS);
            let intensity = intensity / cos / self.response.at(range_m);
            let before = self.layer.exactly_at(point).map(decode);
            let off = before.filter(|before| *before > 0.5 && intensity > 0.5);
            Some(Corrected {
                point,
                range_m,
                intensity,
                weight: cos,
                off: off.map(|before| (intensity / before).ln()),
            })
        };
        let corrected: Vec<Option<Corrected>> = returns.par_iter().zip(intensities).map(correct).collect();
        let known = || corrected.iter().flatten();
        self.layer
            .add(known().map(|r| (r.point, encode(r.intensity), r.weight)))?;
        self.response.learn(known().filter_map(|r| Some((r.range_m, r.off?))));
        Ok(true)
    }

    /// The intensity around a point (world), in the sensor's unit, of the voxels around it; `None` where nothing was measured.
    pub fn at(&self, point: DVec3) -> Option<f32> {
        self.layer.at(point).map(decode)
    }

    /// The intensity that is shown white: nearly all of the surface is darker.
    pub fn white(&self) -> f32 {
        high(&self.layer.some(SAMPLES).into_iter().map(decode).collect::<Vec<f32>>())
    }
}

/// How intensities of a surface are shown: from black to what nearly all of it is darker than.
pub fn channel(values: &[f32]) -> Channel {
    Channel {
        name: "intensity".to_owned(),
        unit: String::new(),
        low: 0.0,
        high: high(values),
        ramp: Ramp::Grey,
        first: false,
    }
}

/// What nearly all of them are less than.
fn high(values: &[f32]) -> f32 {
    let mut sorted: Vec<f32> = values.iter().copied().step_by(values.len() / SAMPLES + 1).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let last = sorted.len().saturating_sub(1) as f32;
    let high = sorted.get((BRIGHT * last) as usize).copied().unwrap_or(1.0);
    high.max(f32::MIN_POSITIVE)
}

/// The grey of an intensity, where `white` is shown white. Eyes tell dark greys apart as the square root does.
pub fn grey(intensity: f32, white: f32) -> [u8; 3] {
    [(255.0 * (intensity / white).clamp(0.0, 1.0).sqrt() + 0.5) as u8; 3]
}

/// Grey of each vertex, brighter as it is stronger, for formats that know only colours.
pub fn greys(values: &[f32]) -> Vec<[u8; 3]> {
    let white = high(values);
    values.iter().map(|value| grey(*value, white)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::Vec3;
    use tsdfuse::{Integrator, Pose, Raycast};

    /// A wall of two halves, seen from straight ahead and from the side.
    fn scans() -> Vec<Scan> {
        [DVec3::ZERO, DVec3::Y * 2.5, DVec3::Y * -2.5]
            .into_iter()
            .map(|eye| {
                let points =
                    (-80..=80).flat_map(|y| (-40..=40).map(move |z| Vec3::new(2.0, 0.02 * y as f32, 0.02 * z as f32)));
                let points: Vec<Vec3> = points.map(|point| point - eye.as_vec3()).collect();
                let intensity = |point: &Vec3| {
                    let cos = 2.0 / point.length();
                    let strength = if point.y + eye.y as f32 > 0.0 { 20.0 } else { 90.0 };
                    strength * cos
                };
                let mut intensities: Vec<f32> = points.iter().map(intensity).collect();
                // A glint.
                intensities[100] = 50_000.0;
                Scan {
                    intensities: Some(intensities),
                    points,
                    pose: Some(Pose {
                        translation: eye,
                        ..Pose::IDENTITY
                    }),
                    ..Default::default()
                }
            })
            .collect()
    }

    fn fused(scans: &[Scan]) -> (VoxelMap, Intensity) {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let mut layer = Intensity::beside(map.config()).unwrap();
        let mut raycast = Raycast::default();
        scans
            .iter()
            .for_each(|scan| drop(raycast.integrate(&mut map, scan).unwrap()));
        assert!(scans.iter().all(|scan| layer.add(&map, scan).unwrap()));
        (map, layer)
    }

    #[test]
    fn intensities_are_those_from_straight_ahead_whatever_the_angle() {
        let (map, layer) = fused(&scans());
        let mesh = tsdfuse::mesh::extract(&map).unwrap();
        let values = layer.of_vertices(&mesh);
        let inner = |vertex: &DVec3| vertex.y.abs() > 0.2 && vertex.y.abs() < 1.4 && vertex.z.abs() < 0.7;
        let mut off: Vec<f32> = mesh
            .vertices
            .iter()
            .zip(&values)
            .filter(|(vertex, _)| inner(vertex))
            .map(|(vertex, value)| {
                let strength = if vertex.y > 0.0 { 20.0 } else { 90.0 };
                (value / strength - 1.0).abs()
            })
            .collect();
        off.sort_unstable_by(f32::total_cmp);
        assert!(off.len() > 500 && off[off.len() * 99 / 100] < 0.12, "{:?}", off.last());
        let shown = channel(&values);
        assert!((80.0..110.0).contains(&shown.high), "{shown:?}");
        assert_eq!(greys(&[0.0, 25.0, 100.0])[2], [255; 3]);
    }

    /// A sensor that reports half as much at twice the range, and drives towards a wall.
    #[test]
    fn what_a_sensor_reports_less_of_from_afar_is_learnt() {
        let scan = |i: i32| {
            let eye = DVec3::X * (0.25 * f64::from(i) - 20.0);
            let grid =
                (-60..=60).flat_map(|y| (-30..=30).map(move |z| Vec3::new(0.0, 0.04 * y as f32, 0.04 * z as f32)));
            let points: Vec<Vec3> = grid.map(|point| point - eye.as_vec3()).collect();
            let intensity = |point: &Vec3| {
                let (range, cos) = (point.length(), -eye.x as f32 / point.length());
                let strength = if point.y > 0.0 { 20.0 } else { 60.0 };
                strength * cos * 10.0 / range
            };
            Scan {
                intensities: Some(points.iter().map(intensity).collect()),
                points,
                pose: Some(Pose {
                    translation: eye,
                    ..Pose::IDENTITY
                }),
                ..Default::default()
            }
        };
        let scans: Vec<Scan> = (0..72).map(scan).collect();
        let (_, layer) = fused(&scans);
        // From 20 m to 5 m, reports grow to four times as much.
        let learnt = layer.response().at(5.0) / layer.response().at(18.0);
        assert!((2.5..5.5).contains(&learnt), "{learnt}");
        // What both halves of the wall have in common does not matter: one is three times as bright.
        let [dark, bright] = [0.8, -0.8].map(|y| layer.at(DVec3::new(0.0, y, 0.3)).unwrap());
        assert!((bright / dark - 3.0).abs() < 0.6, "{dark} {bright}");
    }

    #[test]
    fn layers_merge_and_are_saved_like_maps() {
        let scans = scans();
        let (map, whole) = fused(&scans);
        let mut parts = [
            Intensity::beside(map.config()).unwrap(),
            Intensity::beside(map.config()).unwrap(),
        ];
        parts[0].add(&map, &scans[0]).unwrap();
        scans[1..]
            .iter()
            .for_each(|scan| assert!(parts[1].add(&map, scan).unwrap()));
        let dir = tempfile::tempdir().unwrap();
        let path = Intensity::path_beside(&dir.path().join("street.tsdf"));
        assert!(path.ends_with("street.intensity.tsdf"));
        let [mut first, second] = parts;
        first.layer.merge(&second.layer);
        first.save(&path).unwrap();
        let read = Intensity::read(&path).unwrap();
        for block in first.layer.map().block_indices() {
            assert!(read.layer.map().block(block).unwrap().voxels == first.layer.map().block(block).unwrap().voxels);
        }
        // Nearly: what was learnt of the range differs.
        for y in [-1.2, -0.6, 0.6, 1.2] {
            let [merged, all] = [&read, &whole].map(|layer| layer.at(DVec3::new(2.0, y, 0.3)).unwrap());
            assert!((merged / all - 1.0).abs() < 0.15, "{y}: {merged} {all}");
        }
        tsdfuse_io::map_file::write(&path, &map).unwrap();
        assert!(Intensity::read(&path).unwrap_err().to_string().contains("not a layer"));
        let none = Scan {
            intensities: None,
            ..scans[0].clone()
        };
        assert!(!first.add(&map, &none).unwrap());
    }
}
