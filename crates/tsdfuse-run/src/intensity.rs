//! How strongly a surface reflects: intensities of returns, averaged in a layer of voxels beside the map.
//!
//! The layer is a [`VoxelMap`] of its own on the same grid. Where voxels of a map hold a distance over the truncation, f ∈ [−1, 1], its
//! voxels hold an intensity I, measured against a scale I₀:
//!
//! ```text
//!   f = 2·I / (I + I₀) − 1,     I = I₀·(1 + f) / (1 − f)
//! ```
//!
//! f grows ever more slowly, so a mean of it is hardly moved by a few glints. All else is as for any map: sums of integers that do not
//! depend on order, files, merging, cropping. The map itself, and its bits, stay as they are.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::map::VoxelUpdate;
use tsdfuse::{MapConfig, Mesh, Scan, VoxelMap};
use tsdfuse_view::{Channel, Ramp};

use crate::error::{Result, RunError};

/// I₀: between the intensities of asphalt and of paint, where sensors count to 255.
const SCALE: f32 = 50.0;

/// Truncation of the layer, in voxels: it only scales f, but must be one that a map may have.
const TRUNCATION_VOXELS: f64 = 16.0;

/// Less than this is taken for the cosine of the incidence: where it is smaller, it is not known well.
const LEAST_COS: f32 = 0.25;

/// Vertices of which nothing is known take the mean of their neighbours, so many times.
const FILL_ROUNDS: usize = 12;

/// Intensities of the surface of a map.
#[derive(Debug)]
pub struct Intensity {
    layer: VoxelMap,
}

impl Intensity {
    /// A layer without observations beside a map.
    ///
    /// # Errors
    /// As [`VoxelMap::new`].
    pub fn beside(map: &MapConfig) -> Result<Self> {
        let config = MapConfig {
            truncation_m: TRUNCATION_VOXELS * map.voxel_size_m,
            ..*map
        };
        Ok(Self {
            layer: VoxelMap::new(config)?,
        })
    }

    /// The file of the layer beside that of a map: `street.tsdf` has `street.intensity.tsdf`.
    pub fn path_beside(map: &Path) -> PathBuf {
        let name = map.file_stem().unwrap_or_default().to_string_lossy();
        map.with_file_name(format!("{name}.intensity.tsdf"))
    }

    /// Reads a layer.
    ///
    /// # Errors
    /// As [`tsdfuse_io::map_file::read`]; [`RunError::Config`] for a map that is no such layer.
    pub fn read(path: &Path) -> Result<Self> {
        let layer = tsdfuse_io::map_file::read(path)?;
        let MapConfig {
            truncation_m,
            voxel_size_m,
            ..
        } = layer.config();
        if (truncation_m / voxel_size_m - TRUNCATION_VOXELS).abs() > 1e-6 {
            return Err(RunError::config(format_args!(
                "{}: is a map, not a layer of intensities",
                path.display()
            )));
        }
        Ok(Self { layer })
    }

    /// Saves the layer as a map file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        Ok(tsdfuse_io::map_file::write(path, &self.layer)?)
    }

    /// Bytes of its blocks.
    pub fn memory_bytes(&self) -> usize {
        self.layer.memory_bytes()
    }

    /// Adds a scan that is in `map`; whether it has intensities. Each return counts for the voxel that it lies in, as it would look from
    /// straight ahead (Lambert), the less the flatter it hit: weighted by the cosine of the incidence. That comes from the map's
    /// gradient. Sensors correct for the range themselves.
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
        let truncation_m = self.layer.config().truncation_m as f32;
        let grid = self.layer.grid();
        let update = |(&(point, eye), &intensity): (&(DVec3, DVec3), &f32)| {
            let (voxel, _) = grid.anchor(point)?.split();
            let is_measured = intensity >= 0.0 && intensity.is_finite();
            let gradient = map.sample(point).map(|sample| sample.gradient.normalize_or_zero());
            let back = (eye - point).as_vec3().normalize_or_zero();
            // Where the map knows no direction, the return counts as one of mean incidence.
            let cos = gradient.map_or(0.7, |normal| normal.dot(back).abs()).max(LEAST_COS);
            let corrected = intensity / cos;
            is_measured.then(|| VoxelUpdate {
                voxel,
                distance_m: (2.0 * corrected / (corrected + SCALE) - 1.0) * truncation_m,
                weight: cos,
            })
        };
        let updates: Vec<Option<VoxelUpdate>> = returns.par_iter().zip(intensities).map(update).collect();
        let updated = self.layer.update(updates.into_iter().flatten());
        updated.map_err(|error| RunError::Full(error.to_string()))?;
        Ok(true)
    }

    /// The intensity around a point (world), in the sensor's unit, of the voxels around it; `None` where nothing was measured.
    pub fn at(&self, point: DVec3) -> Option<f32> {
        let (voxel, fraction) = self.layer.grid().anchor(point)?.split();
        let (mut sum, mut weights) = (0.0, 0.0);
        for z in -1..=1 {
            for y in -1..=1 {
                for x in -1..=1 {
                    let offset = IVec3::new(x, y, z);
                    let voxel = self.layer.voxel(voxel + offset);
                    let far = (offset.as_dvec3() + 0.5 - fraction).length();
                    if let Some(f) = voxel.distance().filter(|_| far < REACH_VOXELS) {
                        let weight = voxel.weight() * (1.0 - far / REACH_VOXELS) as f32;
                        (sum, weights) = (sum + f * weight, weights + weight);
                    }
                }
            }
        }
        (weights > 0.0).then(|| {
            let f = (sum / weights).min(0.999);
            SCALE * (1.0 + f) / (1.0 - f)
        })
    }

    /// The intensity of each vertex, in the sensor's unit. Where nothing was measured, that of the vertices around; 0 if there is none.
    pub fn of_vertices(&self, mesh: &Mesh) -> Vec<f32> {
        let mut values: Vec<f32> = mesh
            .vertices
            .par_iter()
            .map(|vertex| self.at(*vertex).unwrap_or(f32::NAN))
            .collect();
        for _ in 0..FILL_ROUNDS {
            let mut sums = vec![(0.0_f32, 0.0_f32); values.len()];
            let mut add = |to: u32, from: u32| {
                let value = values[from as usize];
                if values[to as usize].is_nan() && !value.is_nan() {
                    let sum = &mut sums[to as usize];
                    *sum = (sum.0 + value, sum.1 + 1.0);
                }
            };
            for &[a, b, c] in &mesh.triangles {
                [(a, b), (a, c), (b, a), (b, c), (c, a), (c, b)]
                    .into_iter()
                    .for_each(|(to, from)| add(to, from));
            }
            let mut is_done = true;
            for (value, (sum, count)) in values.iter_mut().zip(sums).filter(|(_, (_, count))| *count > 0.0) {
                (*value, is_done) = (sum / count, false);
            }
            if is_done {
                break;
            }
        }
        values
            .iter_mut()
            .filter(|value| value.is_nan())
            .for_each(|value| *value = 0.0);
        values
    }
}

/// Voxels farther from a point than this do not count for it.
const REACH_VOXELS: f64 = 1.6;

/// How intensities of a surface are shown: from black to what nearly all of it is darker than.
pub fn channel(values: &[f32]) -> Channel {
    let mut sorted: Vec<f32> = values.iter().copied().step_by(values.len() / 100_000 + 1).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let high = sorted
        .get(sorted.len().saturating_sub(1) * 97 / 100)
        .copied()
        .unwrap_or(1.0);
    Channel {
        name: "intensity".to_owned(),
        unit: String::new(),
        low: 0.0,
        high: high.max(f32::MIN_POSITIVE),
        ramp: Ramp::Grey,
        first: false,
    }
}

/// Grey of each vertex, brighter as it is stronger, for formats that know only colours.
pub fn greys(values: &[f32]) -> Vec<[u8; 3]> {
    let high = channel(values).high;
    // Eyes tell dark greys apart as the square root does.
    let grey = |value: &f32| (255.0 * (value / high).clamp(0.0, 1.0).sqrt() + 0.5) as u8;
    values.iter().map(|value| [grey(value); 3]).collect()
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
        first.layer.merge(&second.layer).unwrap();
        first.save(&path).unwrap();
        let read = Intensity::read(&path).unwrap();
        for block in whole.layer.block_indices() {
            assert!(read.layer.block(block).unwrap().voxels == whole.layer.block(block).unwrap().voxels);
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
