//! Which ground can be driven on: a grid of heights seen from above, and what they tell.
//!
//! The layers have the names and meanings of GridMap's filters: how steep the ground is, how high it steps and how rough it is, and from these
//! whether it can be driven on (Wermelinger et al., "Navigation Planning for Legged Robots in Challenging Terrain", IROS 2016,
//! section IV).
//!
//! ```
//! use tsdfuse::glam::{DVec2, DVec3, Vec3};
//! use tsdfuse::{Mesh, raster::Raster};
//! use tsdfuse_plan::{GroundConfig, GroundGrid};
//!
//! // A ramp that rises by a tenth.
//! let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)];
//! let ramp = Mesh {
//!     vertices: corners.map(|(x, y)| DVec3::new(x, y, 0.1 * x)).to_vec(),
//!     normals: vec![Vec3::Z; 4],
//!     triangles: vec![[0, 1, 2], [0, 2, 3]],
//! };
//! let shape = Raster::covering(DVec2::ZERO, DVec2::splat(4.0), 0.2)?;
//! let ground = GroundGrid::of(&ramp, &shape, &GroundConfig::default())?;
//! let (column, row) = shape.cell(DVec2::splat(2.1)).unwrap();
//! let at = |layer: &Raster| layer.values[row * layer.width + column];
//! assert!((at(&ground.elevation) - 0.21).abs() < 1e-6);
//! assert!((at(&ground.slope) - 0.1_f32.atan()).abs() < 1e-4 && at(&ground.roughness) < 1e-4);
//! assert!((0.6..0.95).contains(&at(&ground.traversability)));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::raster::Raster;

use crate::error::PlanError;

/// What can be driven on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundConfig {
    /// Slope and roughness are those of the cells within this distance, metres.
    pub radius_m: f64,
    /// What hangs higher above the ground than this can be driven under, metres.
    pub clearance_m: f64,
    /// The steepest slope that can be driven on, degrees.
    pub max_slope_deg: f64,
    /// The highest step, metres.
    pub max_step_m: f64,
    /// The greatest roughness, metres.
    pub max_roughness_m: f64,
}

impl Default for GroundConfig {
    fn default() -> Self {
        Self {
            radius_m: 0.5,
            clearance_m: 2.0,
            max_slope_deg: 25.0,
            max_step_m: 0.2,
            max_roughness_m: 0.1,
        }
    }
}

/// Steeper surface is no ground but an obstacle, degrees.
const STEEPEST_DEG: f64 = 50.0;

/// Cells with heights that a plane is fitted to, at least.
const LEAST_CELLS: f64 = 6.0;

/// The ground seen from above, layer by layer. NaN where it is not known.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundGrid {
    /// The lowest surface that faces up, world z, metres.
    pub elevation: Raster,
    /// The angle between the ground around and the horizontal, radians.
    pub slope: Raster,
    /// How far the highest surface in a cell and the eight around it, below the clearance, lies above the lowest ground in them, metres.
    pub step: Raster,
    /// How far heights are off the plane that is fitted to them: the root of the mean square, metres.
    pub roughness: Raster,
    /// From 0, what cannot be driven on, to 1, level and even ground: 1 less the mean of slope, step and roughness, each over its limit; 0
    /// beyond any limit. Also 0 where there is an obstacle, but no ground.
    pub traversability: Raster,
}

impl GroundGrid {
    /// The ground of a surface; `shape` is a raster whose cells are to be filled, no smaller than the voxels of the surface's map.
    ///
    /// # Errors
    /// [`PlanError`] names the option that makes no sense.
    pub fn of(mesh: &Mesh, shape: &Raster, config: &GroundConfig) -> Result<Self, PlanError> {
        config.check()?;
        let empty = Raster {
            values: vec![f32::NAN; shape.width * shape.height],
            ..*shape
        };
        let elevation = empty.clone().lowest_level(mesh, STEEPEST_DEG.to_radians());
        let lowest = around(&elevation, f32::min);
        let mut top = elevation.clone();
        for vertex in &mesh.vertices {
            let Some((column, row)) = shape.cell(vertex.truncate()) else {
                continue;
            };
            let at = row * shape.width + column;
            // Also false where no ground is known around.
            if vertex.z <= f64::from(lowest[at]) + config.clearance_m {
                top.values[at] = top.values[at].max(vertex.z as f32);
            }
        }
        let highest = around(&top, f32::max);
        let planes: Vec<(f32, f32)> = (0..elevation.values.len())
            .into_par_iter()
            .map(|at| plane(&elevation, at, config.radius_m).unwrap_or((f32::NAN, f32::NAN)))
            .collect();
        let layer = |value: &dyn Fn(usize) -> f32| Raster {
            values: (0..elevation.values.len()).map(value).collect(),
            ..empty
        };
        let slope = layer(&|at| planes[at].0);
        let roughness = layer(&|at| planes[at].1);
        let step = layer(&|at| {
            if top.values[at].is_nan() {
                f32::NAN
            } else {
                (highest[at] - lowest[at]).max(0.0)
            }
        });
        let limits = [
            config.max_slope_deg.to_radians(),
            config.max_step_m,
            config.max_roughness_m,
        ];
        let traversability = layer(&|at| {
            let values = [&slope, &step, &roughness].map(|layer| f64::from(layer.values[at]));
            let shares = [0, 1, 2].map(|i| values[i] / limits[i]);
            if shares.iter().any(|share| *share > 1.0) {
                0.0
            } else {
                (1.0 - shares.iter().sum::<f64>() / 3.0) as f32
            }
        });
        Ok(Self {
            elevation,
            slope,
            step,
            roughness,
            traversability,
        })
    }

    /// All layers with their names.
    pub fn layers(&self) -> [(&'static str, &Raster); 5] {
        [
            ("elevation", &self.elevation),
            ("slope", &self.slope),
            ("step", &self.step),
            ("roughness", &self.roughness),
            ("traversability", &self.traversability),
        ]
    }
}

impl GroundConfig {
    fn check(&self) -> Result<(), PlanError> {
        let positive = [
            ("radius_m", self.radius_m),
            ("clearance_m", self.clearance_m),
            ("max_slope_deg", self.max_slope_deg),
            ("max_step_m", self.max_step_m),
            ("max_roughness_m", self.max_roughness_m),
        ];
        for (name, value) in positive {
            // Also false for NaN.
            if !(value > 0.0 && value < 1e3) {
                return Err(PlanError::new(name, value, "more than 0, less than 1,000"));
            }
        }
        Ok(())
    }
}

/// The least or greatest value of each cell and the eight around it.
fn around(raster: &Raster, better: fn(f32, f32) -> f32) -> Vec<f32> {
    let (width, height) = (raster.width, raster.height);
    let of = |at: usize| {
        let (column, row) = (at % width, at / width);
        let rows = row.saturating_sub(1)..=(row + 1).min(height - 1);
        let columns = || column.saturating_sub(1)..=(column + 1).min(width - 1);
        let near = rows.flat_map(|row| columns().map(move |column| raster.values[row * width + column]));
        near.fold(f32::NAN, better)
    };
    (0..width * height).into_par_iter().map(of).collect()
}

/// The slope and the roughness of the heights within a radius of a cell; `None` where too few are known.
fn plane(heights: &Raster, at: usize, radius_m: f64) -> Option<(f32, f32)> {
    let base = heights.values[at];
    if base.is_nan() {
        return None;
    }
    let reach = (radius_m / heights.cell_m).floor().max(1.0) as isize;
    let (column, row) = ((at % heights.width) as isize, (at / heights.width) as isize);
    let near = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
    let known: Vec<[f64; 3]> = near
        .filter(|(dx, dy)| dx * dx + dy * dy <= reach * reach)
        .filter_map(|(dx, dy)| {
            let (x, y) = (column + dx, row + dy);
            let is_inside = x >= 0 && y >= 0 && x < heights.width as isize && y < heights.height as isize;
            let height = is_inside.then(|| heights.values[y as usize * heights.width + x as usize])?;
            let z = f64::from(height) - f64::from(base);
            (!z.is_nan()).then_some([dx as f64 * heights.cell_m, -dy as f64 * heights.cell_m, z])
        })
        .collect();
    let n = known.len() as f64;
    if n < LEAST_CELLS {
        return None;
    }
    let mean = |axis: usize| known.iter().map(|p| p[axis]).sum::<f64>() / n;
    let middle = [mean(0), mean(1), mean(2)];
    let sum = |a: usize, b: usize| {
        known
            .iter()
            .map(|p| (p[a] - middle[a]) * (p[b] - middle[b]))
            .sum::<f64>()
    };
    let (xx, xy, yy, xz, yz) = (sum(0, 0), sum(0, 1), sum(1, 1), sum(0, 2), sum(1, 2));
    let determinant = xx * yy - xy * xy;
    // All in one line.
    if determinant <= 1e-6 * (xx + yy) * (xx + yy) {
        return None;
    }
    let (a, b) = ((xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant);
    let off = |p: &[f64; 3]| p[2] - middle[2] - a * (p[0] - middle[0]) - b * (p[1] - middle[1]);
    let square = known.iter().map(|p| off(p) * off(p)).sum::<f64>() / n;
    Some((a.hypot(b).atan() as f32, square.sqrt() as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::{DVec2, DVec3, Vec3};

    /// Squares of 10 cm, x and y from `low` to `high`.
    fn sheet(mesh: &mut Mesh, low: DVec2, high: DVec2, place: impl Fn(f64, f64) -> DVec3) {
        let steps = ((high - low) / 0.1).round();
        let (columns, rows) = (steps.x as u32, steps.y as u32);
        let first = mesh.vertices.len() as u32;
        for j in 0..=rows {
            for i in 0..=columns {
                mesh.vertices
                    .push(place(low.x + 0.1 * f64::from(i), low.y + 0.1 * f64::from(j)));
                mesh.normals.push(Vec3::Z);
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                let a = first + j * (columns + 1) + i;
                let (b, c, d) = (a + 1, a + columns + 2, a + columns + 1);
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    /// A street with a kerb of 12 cm at y = 4, a ramp of 20° from x = 6 on, a wall at y = 8, and a bridge over all at a height of 5 m.
    fn street() -> Mesh {
        let mut mesh = Mesh::default();
        let rise = 20.0_f64.to_radians().tan();
        let height = |x: f64, y: f64| rise * (x - 6.0).max(0.0) + if y > 4.05 { 0.12 } else { 0.0 };
        sheet(&mut mesh, DVec2::ZERO, DVec2::new(12.0, 8.0), |x, y| {
            DVec3::new(x, y, height(x, y))
        });
        sheet(&mut mesh, DVec2::ZERO, DVec2::new(12.0, 6.0), |x, z| {
            DVec3::new(x, 8.0, z)
        });
        sheet(&mut mesh, DVec2::ZERO, DVec2::new(3.0, 8.0), |x, y| {
            DVec3::new(x, y, 5.0)
        });
        mesh
    }

    fn ground(config: &GroundConfig) -> GroundGrid {
        let shape = Raster::covering(DVec2::ZERO, DVec2::new(12.0, 9.0), 0.2).unwrap();
        GroundGrid::of(&street(), &shape, config).unwrap()
    }

    fn at(layer: &Raster, x: f64, y: f64) -> f32 {
        let (column, row) = layer.cell(DVec2::new(x, y)).unwrap();
        layer.values[row * layer.width + column]
    }

    #[test]
    fn streets_ramps_kerbs_and_walls_are_told_apart() {
        let found = ground(&GroundConfig::default());
        let GroundGrid {
            elevation,
            slope,
            step,
            roughness,
            traversability,
        } = &found;
        // The street, also under the bridge.
        for x in [1.5, 4.5] {
            assert_eq!(
                (at(elevation, x, 2.0), at(slope, x, 2.0), at(step, x, 2.0)),
                (0.0, 0.0, 0.0)
            );
            assert!(at(traversability, x, 2.0) > 0.999);
        }
        // The ramp.
        assert!((at(slope, 9.0, 2.0) - 20_f32.to_radians()).abs() < 0.01);
        assert!((at(elevation, 9.1, 2.1) - 3.1 * 20_f32.to_radians().tan()).abs() < 0.01);
        assert!(
            (0.1..0.5).contains(&at(traversability, 9.0, 2.0)),
            "{}",
            at(traversability, 9.0, 2.0)
        );
        // The kerb.
        assert!((at(step, 4.5, 4.1) - 0.12).abs() < 0.01 && at(roughness, 4.5, 4.1) > 0.02);
        assert!((0.1..0.9).contains(&at(traversability, 4.5, 4.1)));
        // The wall, and beyond it.
        assert!(at(step, 4.5, 7.9) > 1.5 && at(traversability, 4.5, 7.9) == 0.0);
        assert!(at(traversability, 4.5, 8.7).is_nan() && at(elevation, 4.5, 8.7).is_nan());
        let low = GroundConfig {
            max_step_m: 0.1,
            ..GroundConfig::default()
        };
        assert_eq!(at(&ground(&low).traversability, 4.5, 4.1), 0.0);
        assert_eq!(found.layers()[4].0, "traversability");
    }

    #[test]
    fn options_that_make_no_sense_are_refused() {
        let shape = Raster::covering(DVec2::ZERO, DVec2::ONE, 0.2).unwrap();
        let config = GroundConfig {
            max_step_m: f64::NAN,
            ..GroundConfig::default()
        };
        let told = GroundGrid::of(&Mesh::default(), &shape, &config).unwrap_err();
        assert_eq!(told.to_string(), "max_step_m = NaN: more than 0, less than 1,000");
        let nothing = GroundGrid::of(&Mesh::default(), &shape, &GroundConfig::default()).unwrap();
        assert!(nothing.layers().iter().all(|(_, layer)| layer.known() == 0));
    }
}
