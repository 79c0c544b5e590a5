//! Numbers on a plane, cell by cell: slices of the map, heights of the surface, and the ground among them.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::map::VoxelMap;
use crate::mesh::Mesh;

/// Cells that a raster has at most: 4 GiB.
const MOST_CELLS: f64 = (1_u64 << 30) as f64;

/// A number for each square cell of a rectangle; NaN where nothing is known.
///
/// ```text
///   row 0      ┌──┬──┬──┐          the plane's axes: right (u) and up (v);
///              ├──┼──┼──┤          seen from above, u is x and v is y
///   last row   └──┴──┴──┘
///              low = the lower left corner
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    /// Its lower left corner, metres along u and v.
    pub low: DVec2,
    /// Edge of a cell, metres.
    pub cell_m: f64,
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row from the top.
    pub values: Vec<f32>,
}

/// Why there is no raster.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RasterError {
    /// The rectangle or the cells make no sense.
    #[error("no raster has cells of {cell_m} m over {} m by {} m", size.x, size.y)]
    Shape {
        /// Edge of a cell.
        cell_m: f64,
        /// Edges of the rectangle.
        size: DVec2,
    },
}

/// A vertical or level plane through the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Where u = v = 0, world, metres.
    pub origin: DVec3,
    /// The direction of u, a unit vector.
    pub right: DVec3,
    /// The direction of v, a unit vector.
    pub up: DVec3,
}

impl Plane {
    /// Level at a height, u = x and v = y.
    pub fn level(z: f64) -> Self {
        Self {
            origin: DVec3::Z * z,
            right: DVec3::X,
            up: DVec3::Y,
        }
    }

    /// Vertical, from one place (x, y) towards another one; u begins at the first, and v is the height. `None` if both are one.
    pub fn vertical(from: DVec2, to: DVec2) -> Option<Self> {
        let right = (to - from).try_normalize()?;
        Some(Self {
            origin: from.extend(0.0),
            right: right.extend(0.0),
            up: DVec3::Z,
        })
    }
}

impl Raster {
    /// A raster without values that covers a rectangle.
    ///
    /// # Errors
    /// [`RasterError`] for a rectangle or cells without size, and for more than a thousand million cells.
    pub fn covering(low: DVec2, high: DVec2, cell_m: f64) -> Result<Self, RasterError> {
        let size = high - low;
        let cells = (size / cell_m).ceil().max(DVec2::ONE);
        // Also false for NaN.
        if !(cell_m > 0.0 && size.min_element() >= 0.0 && cells.x * cells.y <= MOST_CELLS && low.is_finite()) {
            return Err(RasterError::Shape { cell_m, size });
        }
        let (width, height) = (cells.x as usize, cells.y as usize);
        Ok(Self {
            low,
            cell_m,
            width,
            height,
            values: vec![f32::NAN; width * height],
        })
    }

    /// The middle of a cell, metres along u and v.
    pub fn center(&self, column: usize, row: usize) -> DVec2 {
        let up = self.height - 1 - row;
        self.low + (DVec2::new(column as f64, up as f64) + 0.5) * self.cell_m
    }

    /// The cell in which a place lies, if any: column and row.
    pub fn cell(&self, place: DVec2) -> Option<(usize, usize)> {
        let at = ((place - self.low) / self.cell_m).floor();
        let is_inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.width as f64 && at.y < self.height as f64;
        is_inside.then(|| (at.x as usize, self.height - 1 - at.y as usize))
    }

    /// How many cells have a value.
    pub fn known(&self) -> usize {
        self.values.iter().filter(|value| !value.is_nan()).count()
    }

    /// The signed distances of a map on a plane, metres; NaN where it was never observed. The raster gives the rectangle.
    pub fn slice(mut self, map: &VoxelMap, plane: &Plane) -> Self {
        let (width, shape) = (
            self.width,
            Self {
                values: Vec::new(),
                ..self
            },
        );
        self.values.par_chunks_mut(width).enumerate().for_each(|(row, values)| {
            let place = |column| {
                let at = shape.center(column, row);
                plane.origin + plane.right * at.x + plane.up * at.y
            };
            let places: Vec<DVec3> = (0..width).map(place).collect();
            for (value, place) in values.iter_mut().zip(places) {
                *value = map.sample(place).map_or(f32::NAN, |sample| sample.distance_m);
            }
        });
        self
    }

    /// The highest surface over each cell's middle, world z, metres: a surface model.
    pub fn highest(self, mesh: &Mesh) -> Self {
        self.heights(mesh, |_| true, f32::max)
    }

    /// The lowest surface over each cell's middle that is no steeper than this and faces up, world z, metres.
    pub fn lowest_level(self, mesh: &Mesh, most_slope_rad: f64) -> Self {
        let least_up = most_slope_rad.cos();
        self.heights(mesh, |normal| normal.z >= least_up, f32::min)
    }

    fn heights(mut self, mesh: &Mesh, is_wanted: impl Fn(DVec3) -> bool, better: fn(f32, f32) -> f32) -> Self {
        for corners in &mesh.triangles {
            let [a, b, c] = corners.map(|v| mesh.vertices[v as usize]);
            let twice_area = (b - a).cross(c - a);
            if twice_area.z == 0.0 || !is_wanted(twice_area.normalize_or_zero()) {
                continue;
            }
            let [first, last] =
                [a.min(b).min(c), a.max(b).max(c)].map(|corner| (corner.truncate() - self.low) / self.cell_m - 0.5);
            for column in cells(first.x, last.x, self.width) {
                for up in cells(first.y, last.y, self.height) {
                    let row = self.height - 1 - up;
                    let place = self.center(column, row);
                    // Barycentric coordinates in the plane seen from above.
                    let share = |p: DVec3, q: DVec3| (q - p).truncate().perp_dot(place - p.truncate()) / twice_area.z;
                    let [u, v, w] = [share(b, c), share(c, a), share(a, b)];
                    if u < 0.0 || v < 0.0 || w < 0.0 {
                        continue;
                    }
                    let height = (u * a.z + v * b.z + w * c.z) as f32;
                    let value = &mut self.values[row * self.width + column];
                    *value = if value.is_nan() { height } else { better(*value, height) };
                }
            }
        }
        self
    }

    /// The ground among the lowest surfaces: what stands on it (cars, walls, roofs seen from above) is taken away, and cells without
    /// ground become what lies around them, where that is no farther than half of what may stand there.
    ///
    /// Progressive morphological filter (Zhang et al. 2003): in windows that grow to `widest_m`, a cell that is higher above the
    /// opened surface than the slope allows is no ground.
    pub fn ground(mut self, config: &GroundConfig) -> Self {
        let holes_before = self.values.clone();
        self.fill(usize::MAX);
        let mut radius = 1_usize;
        let mut is_ground: Vec<bool> = holes_before.iter().map(|value| !value.is_nan()).collect();
        let mut last = 0.0;
        loop {
            let window_m = (2 * radius + 1) as f64 * self.cell_m;
            let opened = self.extreme(radius, f32::min).extreme(radius, f32::max);
            let most = (config.slope * (window_m - last) + config.step_m).min(config.most_step_m) as f32;
            for (i, value) in self.values.iter_mut().enumerate() {
                if *value - opened.values[i] > most {
                    is_ground[i] = false;
                    *value = opened.values[i];
                }
            }
            if window_m >= config.widest_m || 2 * radius >= self.width.max(self.height) {
                break;
            }
            (last, radius) = (window_m, 2 * radius);
        }
        for ((value, is_ground), before) in self.values.iter_mut().zip(is_ground).zip(holes_before) {
            *value = if is_ground { before } else { f32::NAN };
        }
        self.fill((0.5 * config.widest_m / self.cell_m).ceil() as usize);
        self
    }

    /// The least or greatest value within a square window around each cell, `radius` cells to each side.
    fn extreme(&self, radius: usize, better: fn(f32, f32) -> f32) -> Self {
        let line = |values: &[f32]| -> Vec<f32> {
            let window = |i: usize| &values[i.saturating_sub(radius)..(i + radius + 1).min(values.len())];
            (0..values.len())
                .map(|i| window(i).iter().copied().fold(f32::NAN, better))
                .collect()
        };
        let rows: Vec<f32> = self.values.par_chunks(self.width).flat_map_iter(&line).collect();
        let columns: Vec<Vec<f32>> = (0..self.width)
            .into_par_iter()
            .map(|column| {
                line(
                    &rows
                        .iter()
                        .skip(column)
                        .step_by(self.width)
                        .copied()
                        .collect::<Vec<_>>(),
                )
            })
            .collect();
        let values = (0..self.values.len())
            .map(|i| columns[i % self.width][i / self.width])
            .collect();
        Self { values, ..*self }
    }

    /// Gives cells without a value one: the mean of what was found around them, ring by ring, so many
    /// rings far.
    fn fill(&mut self, rings: usize) {
        let (width, height) = (self.width, self.height);
        let around = move |i: usize| {
            let (x, y) = (i % width, i / width);
            let near = move |at: usize, most: usize| at.saturating_sub(1)..=(at + 1).min(most - 1);
            near(y, height)
                .flat_map(move |y| near(x, width).map(move |x| y * width + x))
                .filter(move |&j| j != i)
        };
        let mut front: Vec<usize> = (0..self.values.len())
            .filter(|&i| self.values[i].is_nan() && around(i).any(|j| !self.values[j].is_nan()))
            .collect();
        for _ in 0..rings {
            if front.is_empty() {
                break;
            }
            let mean = |&i: &usize| {
                let known = around(i).map(|j| self.values[j]).filter(|value| !value.is_nan());
                let (sum, count) = known.fold((0.0, 0.0), |(sum, count), value| (sum + f64::from(value), count + 1.0));
                (i, (sum / count) as f32)
            };
            let found: Vec<(usize, f32)> = front.iter().map(mean).collect();
            found.iter().for_each(|&(i, value)| self.values[i] = value);
            let mut next: Vec<usize> = found
                .iter()
                .flat_map(|&(i, _)| around(i))
                .filter(|&j| self.values[j].is_nan())
                .collect();
            next.sort_unstable();
            next.dedup();
            front = next;
        }
    }
}

/// Whole numbers from `low` to `high` that are below `count`.
fn cells(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    let low = low.ceil().max(0.0);
    let end = (high.floor() + 1.0).min(count as f64).max(low);
    low as usize..end as usize
}

/// What is ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundConfig {
    /// The ground rises by no more than this, metres per metre.
    pub slope: f64,
    /// What stands lower than this is ground, metres.
    pub step_m: f64,
    /// What stands higher than this is none, however steep the ground, metres.
    pub most_step_m: f64,
    /// The width of the widest thing that stands on the ground, metres.
    pub widest_m: f64,
}

impl Default for GroundConfig {
    fn default() -> Self {
        Self {
            slope: 0.3,
            step_m: 0.2,
            most_step_m: 2.5,
            widest_m: 20.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Integrator, MapConfig, Pose, Raycast, Scan};
    use glam::Vec3;

    /// Two triangles of a rectangle at heights that its four corners give.
    fn sheet(low: DVec2, high: DVec2, z: impl Fn(DVec2) -> f64) -> Mesh {
        let corners = [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)];
        Mesh {
            vertices: corners.iter().map(|&corner| corner.extend(z(corner))).collect(),
            normals: vec![Vec3::Z; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    fn add(mesh: &mut Mesh, other: Mesh) {
        let first = mesh.vertices.len() as u32;
        mesh.triangles
            .extend(other.triangles.iter().map(|corners| corners.map(|v| v + first)));
        mesh.vertices.extend(other.vertices);
    }

    #[test]
    fn heights_are_those_of_the_surface_and_the_ground_has_no_cars() {
        let slope = |at: DVec2| 100.0 + 0.05 * at.x - 0.02 * at.y;
        let (low, high) = (DVec2::new(-20.0, -10.0), DVec2::new(20.0, 10.0));
        let mut mesh = sheet(low, high, slope);
        // A car's roof and a house.
        add(
            &mut mesh,
            sheet(DVec2::new(1.0, 1.0), DVec2::new(5.0, 3.0), |at| slope(at) + 1.5),
        );
        add(
            &mut mesh,
            sheet(DVec2::new(-15.0, -6.0), DVec2::new(-5.0, 6.0), |at| slope(at) + 6.0),
        );
        let raster = || Raster::covering(low, high, 0.25).unwrap();
        assert_eq!((raster().width, raster().height), (160, 80));
        let top = raster().highest(&mesh);
        let at = |raster: &Raster, x: f64, y: f64| {
            let (column, row) = raster.cell(DVec2::new(x, y)).unwrap();
            (
                f64::from(raster.values[row * raster.width + column]),
                raster.center(column, row),
            )
        };
        for (x, y, above) in [(10.0, -5.0, 0.0), (3.0, 2.0, 1.5), (-10.0, 0.0, 6.0), (-19.0, 9.0, 0.0)] {
            let (z, place) = at(&top, x, y);
            assert!((z - slope(place) - above).abs() < 1e-4, "{x} {y}: {z}");
        }
        assert_eq!(top.known(), top.values.len());
        // Seen from above only, there is no ground below roofs; it is found all the same.
        let ground = top.clone().ground(&GroundConfig::default());
        for (i, &z) in ground.values.iter().enumerate() {
            let place = ground.center(i % ground.width, i / ground.width);
            assert!((f64::from(z) - slope(place)).abs() < 0.35, "{place}: {z}");
        }
        // Far from all that was seen, nothing is made up.
        let wide = Raster::covering(low - 40.0, high + 40.0, 0.5).unwrap().highest(&mesh);
        let wide = wide.ground(&GroundConfig::default());
        assert!(at(&wide, -55.0, 0.0).0.is_nan() && !at(&wide, -25.0, 0.0).0.is_nan());
        // A wall is no level surface.
        let wall = Mesh {
            vertices: vec![DVec3::ZERO, DVec3::new(3.0, 0.01, 0.0), DVec3::new(3.0, 0.02, 3.0)],
            normals: vec![Vec3::X; 3],
            triangles: vec![[0, 1, 2]],
        };
        assert_eq!(
            Raster::covering(DVec2::ZERO, DVec2::ONE, 0.001)
                .unwrap()
                .lowest_level(&wall, 0.8)
                .known(),
            0
        );
    }

    #[test]
    fn slices_hold_distances_and_end_where_nothing_was_observed() {
        let points = (-60..=60).flat_map(|y| (-60..=60).map(move |z| Vec3::new(2.0, 0.02 * y as f32, 0.02 * z as f32)));
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let scan = Scan {
            points: points.collect(),
            pose: Some(Pose::IDENTITY),
            ..Default::default()
        };
        Raycast::default().integrate(&mut map, &scan).unwrap();
        let level = Raster::covering(DVec2::new(1.5, -0.5), DVec2::new(2.5, 0.5), 0.02).unwrap();
        let level = level.slice(&map, &Plane::level(0.1));
        for (i, &distance) in level.values.iter().enumerate() {
            let place = level.center(i % level.width, i / level.width);
            if (place.x - 2.0).abs() < 0.05 {
                assert!(
                    (f64::from(distance) - (2.0 - place.x)).abs() < 0.02,
                    "{place}: {distance}"
                );
            }
            assert!(place.x > 1.7 || distance.is_nan(), "{place}: {distance}");
        }
        // Across, the same wall: u runs along x from 1 on.
        let plane = Plane::vertical(DVec2::new(1.0, 0.0), DVec2::new(3.0, 0.0)).unwrap();
        let section = Raster::covering(DVec2::new(0.9, 0.0), DVec2::new(1.1, 0.5), 0.02)
            .unwrap()
            .slice(&map, &plane);
        for (i, &distance) in section.values.iter().enumerate() {
            let u = section.center(i % section.width, i / section.width).x;
            if (u - 1.0).abs() < 0.05 {
                assert!((f64::from(distance) - (1.0 - u)).abs() < 0.02, "{u}: {distance}");
            }
        }
        assert_eq!(Plane::vertical(DVec2::ONE, DVec2::ONE), None);
        assert!(Raster::covering(DVec2::ZERO, DVec2::ONE, 0.0).is_err());
        assert!(Raster::covering(DVec2::ZERO, DVec2::ONE * 1e9, 0.01).is_err());
    }
}
