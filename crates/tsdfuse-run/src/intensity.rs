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

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tsdfuse::glam::{DVec3, IVec3};
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
/// A return of voxel v from range r has, after correction for its angle, the logarithm of its intensity a(v) + b(r): each voxel has a strength
/// of its own, and the sensor one response b, which is linear in log r between knots. Both by least squares over a sample of voxels that are seen
/// from several ranges; their strengths are eliminated from the normal equations (fixed effects, as econometrics calls it). Over all returns, b
/// is 0 in the mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangeResponse {
    /// b at ranges of 2^(i/[`PER_OCTAVE`]) m.
    logs: Vec<f64>,
    /// The normal equations of b, row by row, and their right side.
    normal: Vec<f64>,
    right: Vec<f64>,
    /// Weights of returns at each knot.
    seen: Vec<f64>,
    #[serde(with = "listed")]
    voxels: BTreeMap<[i32; 3], Seen>,
}

/// What was seen of a voxel: the number of returns, the sum of the logarithms, and the weights of returns at each knot, where they are not 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Seen {
    count: f64,
    sum: f64,
    knots: Vec<(usize, f64)>,
}

/// A map with keys that are no text, for JSON.
mod listed {
    use std::collections::BTreeMap;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Seen;

    type Voxels = BTreeMap<[i32; 3], Seen>;

    pub(super) fn serialize<S: Serializer>(voxels: &Voxels, serializer: S) -> Result<S::Ok, S::Error> {
        voxels.iter().collect::<Vec<_>>().serialize(serializer)
    }

    pub(super) fn deserialize<'a, D: Deserializer<'a>>(deserializer: D) -> Result<Voxels, D::Error> {
        Ok(Vec::deserialize(deserializer)?.into_iter().collect())
    }
}

/// Ranges from 1 m to 256 m, so many to twice the range.
const PER_OCTAVE: f32 = 4.0;
const KNOTS: usize = 33;

/// One of so many voxels is looked at, and no more than this in all.
const ONE_OF: u64 = 64;
const MOST_VOXELS: usize = 16_384;

/// Neighbouring knots are held together by as much as so many returns could tell: those that no return has seen follow the others.
const STIFFNESS: f64 = 2.0;

/// Returns that are farther than this from what is expected of their voxel count as if they were this far: glints.
const MOST_OFF: f64 = 1.5;

/// Factors from this to its inverse are possible.
const MOST_LOG: f64 = 2.5;

impl Default for RangeResponse {
    fn default() -> Self {
        Self {
            logs: vec![0.0; KNOTS],
            normal: vec![0.0; KNOTS * KNOTS],
            right: vec![0.0; KNOTS],
            seen: vec![0.0; KNOTS],
            voxels: BTreeMap::new(),
        }
    }
}

/// The two knots beside a range, with their shares.
fn knots(range_m: f32) -> [(usize, f64); 2] {
    let place = f64::from(PER_OCTAVE * range_m.log2()).clamp(0.0, (KNOTS - 1) as f64);
    let first = (place as usize).min(KNOTS - 2);
    let share = place - first as f64;
    [(first, 1.0 - share), (first + 1, share)]
}

/// Whether a voxel is one of those that are looked at.
fn is_sampled(voxel: IVec3) -> bool {
    let [x, y, z] = voxel.to_array().map(|i| i as u64);
    let mixed = x.wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ y.wrapping_mul(0xC2B2_AE3D_27D4_EB4F)
        ^ z.wrapping_mul(0x1656_67B1_9E37_79F9);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40).is_multiple_of(ONE_OF)
}

impl RangeResponse {
    /// By how much stronger than on average a surface is reported at a range.
    pub fn at(&self, range_m: f32) -> f32 {
        knots(range_m)
            .map(|(knot, share)| share * self.logs[knot])
            .iter()
            .sum::<f64>()
            .exp() as f32
    }

    /// Learns from returns: their voxels, ranges, and the logarithms of their intensities, corrected for the angle.
    fn learn(&mut self, returns: impl IntoIterator<Item = (IVec3, f32, f64)>) {
        for (voxel, range_m, log) in returns {
            self.see(voxel, range_m, log);
        }
        self.solve();
    }

    fn see(&mut self, voxel: IVec3, range_m: f32, log: f64) {
        let is_known = self.voxels.contains_key(&voxel.to_array());
        if !is_known && self.voxels.len() >= MOST_VOXELS {
            return;
        }
        let mut seen = self.voxels.remove(&voxel.to_array()).unwrap_or_default();
        let at = knots(range_m);
        let mut log = log;
        if seen.count >= 3.0 {
            let response =
                |knots: &[(usize, f64)]| knots.iter().map(|(knot, share)| share * self.logs[*knot]).sum::<f64>();
            let expected = (seen.sum - response(&seen.knots)) / seen.count + response(&at);
            log = log.clamp(expected - MOST_OFF, expected + MOST_OFF);
        }
        // The voxel's strength is eliminated: what all its returns have in common tells nothing.
        self.eliminate(&seen, -1.0);
        for (knot, share) in at {
            for (other, other_share) in at {
                self.normal[knot * KNOTS + other] += share * other_share;
            }
            self.right[knot] += share * log;
            self.seen[knot] += share;
            match seen.knots.iter_mut().find(|(of, _)| *of == knot) {
                Some((_, sum)) => *sum += share,
                None => seen.knots.push((knot, share)),
            }
        }
        seen.count += 1.0;
        seen.sum += log;
        self.eliminate(&seen, 1.0);
        self.voxels.insert(voxel.to_array(), seen);
    }

    fn eliminate(&mut self, seen: &Seen, sign: f64) {
        if seen.count == 0.0 {
            return;
        }
        for (knot, share) in &seen.knots {
            for (other, other_share) in &seen.knots {
                self.normal[knot * KNOTS + other] -= sign * share * other_share / seen.count;
            }
            self.right[*knot] -= sign * share * seen.sum / seen.count;
        }
    }

    /// Solves the normal equations (Cholesky).
    fn solve(&mut self) {
        let mut matrix = self.normal.clone();
        for knot in 0..KNOTS {
            matrix[knot * KNOTS + knot] += 1e-6;
        }
        for knot in 1..KNOTS {
            let (a, b) = (knot - 1, knot);
            for (row, column, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
                matrix[row * KNOTS + column] += sign * STIFFNESS;
            }
        }
        let mut logs = self.right.clone();
        for row in 0..KNOTS {
            for column in 0..=row {
                let dot: f64 = (0..column)
                    .map(|k| matrix[row * KNOTS + k] * matrix[column * KNOTS + k])
                    .sum();
                let rest = matrix[row * KNOTS + column] - dot;
                matrix[row * KNOTS + column] = if row == column {
                    rest.max(1e-12).sqrt()
                } else {
                    rest / matrix[column * KNOTS + column]
                };
            }
            let dot: f64 = (0..row).map(|k| matrix[row * KNOTS + k] * logs[k]).sum();
            logs[row] = (logs[row] - dot) / matrix[row * KNOTS + row];
        }
        for row in (0..KNOTS).rev() {
            let dot: f64 = (row + 1..KNOTS).map(|k| matrix[k * KNOTS + row] * logs[k]).sum();
            logs[row] = (logs[row] - dot) / matrix[row * KNOTS + row];
        }
        // What is the same at all ranges is the surface's own.
        let weight: f64 = self.seen.iter().sum();
        let mean = logs.iter().zip(&self.seen).map(|(log, seen)| log * seen).sum::<f64>() / weight.max(1.0);
        self.logs = logs
            .into_iter()
            .map(|log| (log - mean).clamp(-MOST_LOG, MOST_LOG))
            .collect();
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
    pub(crate) fn read_beside_store(store: &Path, done: usize, response: RangeResponse) -> Result<Self> {
        for name in ["intensity", "intensity-next"] {
            let path = path_beside(store, name);
            if path.is_file() {
                let layer = Self::read(&path)?;
                if layer.layer.scans() == done {
                    return Ok(Self { response, ..layer });
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
            /// If it is looked at: its voxel, and the logarithm of its intensity, corrected for the angle.
            told: Option<(IVec3, f64)>,
        }
        let grid = map.grid();
        let correct = |(&(point, eye), &intensity): (&(DVec3, DVec3), &f32)| {
            if !(intensity >= 0.0 && intensity.is_finite()) {
                return None;
            }
            let gradient = map.sample(point).map(|sample| sample.gradient.normalize_or_zero());
            let way = (eye - point).as_vec3();
            let range_m = way.length();
            let known = gradient.map(|normal| normal.dot(way / range_m).abs());
            // Where the map knows no direction, the return counts as one of mean incidence.
            let cos = known.unwrap_or(0.7).max(LEAST_COS);
            let upright = intensity / cos;
            let is_clear = known.is_some_and(|cos| cos > LEAST_COS) && upright > 0.5;
            let voxel = grid.anchor(point).map(|anchor| anchor.split().0);
            let told = voxel.filter(|voxel| is_clear && is_sampled(*voxel));
            Some(Corrected {
                point,
                range_m,
                intensity: upright / self.response.at(range_m),
                weight: cos,
                told: told.map(|voxel| (voxel, f64::from(upright).ln())),
            })
        };
        let corrected: Vec<Option<Corrected>> = returns.par_iter().zip(intensities).map(correct).collect();
        let known = || corrected.iter().flatten();
        self.layer
            .add(known().map(|r| (r.point, encode(r.intensity), r.weight)))?;
        let told = known().filter_map(|r| r.told.map(|(voxel, log)| (voxel, r.range_m, log)));
        self.response.learn(told);
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
        for (near, far) in [(5.0, 18.0), (5.0, 9.0), (9.0, 18.0)] {
            let learnt = layer.response().at(near) / layer.response().at(far);
            assert!((learnt * near / far - 1.0).abs() < 0.05, "{near} {far}: {learnt}");
        }
        // What both halves of the wall have in common does not matter: one is three times as bright.
        let [dark, bright] = [0.8, -0.8].map(|y| layer.at(DVec3::new(0.0, y, 0.3)).unwrap());
        assert!((bright / dark - 3.0).abs() < 0.6, "{dark} {bright}");
    }

    /// Voxels of all strengths, each seen from some ranges; bright ones from afar, as by a sensor that turns its power up for dark ones.
    #[test]
    fn strengths_of_voxels_do_not_pass_for_the_response() {
        let truth = |range_m: f64| 0.4 * (range_m / 20.0).ln() - 0.8 * (range_m / 40.0).powi(2);
        let mut response = RangeResponse::default();
        let random =
            |seed: u64| f64::from((seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as u32) / f64::from(1 << 24);
        for scan in 0..20_u64 {
            let returns = (0..400_u64).map(|i| {
                let first = 4.0 + 50.0 * random(i);
                let range_m = first * (1.0 - 0.03 * scan as f64);
                let noise = 0.3 * (random(1000 * scan + 31 * i) - 0.5) + if (i + scan) % 97 == 0 { 5.0 } else { 0.0 };
                let strength = 0.05 * first + 2.0 * random(7 * i);
                (
                    IVec3::new(i as i32, 0, 0),
                    range_m as f32,
                    strength + truth(range_m) + noise,
                )
            });
            response.learn(returns);
        }
        for range_m in [4.0, 8.0, 16.0, 30.0, 45.0] {
            let learnt = response.at(range_m) / response.at(10.0);
            let wanted = (truth(f64::from(range_m)) - truth(10.0)).exp();
            assert!(
                (f64::from(learnt) / wanted - 1.0).abs() < 0.08,
                "{range_m}: {learnt} {wanted}"
            );
        }
        let json = serde_json::to_vec(&response).unwrap();
        assert_eq!(serde_json::from_slice::<RangeResponse>(&json).unwrap(), response);
        // No more voxels are kept than these.
        response.learn((0..MOST_VOXELS as i32 + 9).map(|i| (IVec3::new(i, 1, 0), 5.0, 1.0)));
        assert_eq!(response.voxels.len(), MOST_VOXELS);
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
