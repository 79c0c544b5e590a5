//! What tracking knows of the world: cells of several sizes, each with the plane of the points in it.
//!
//! Space is divided into cubes at [`LEVELS`] sizes, each twice the one before. Every cube keeps the number, the sum and the
//! products of its points, and from these the plane with its uncertainty. A point asks the cubes that it lies in, one of each
//! size, and takes the plane that foretells it best: a large one where the surface is flat, so that hundreds of points say
//! where it is, a small one where it is not. Nothing is searched for, and nothing depends on whether the sensor is indoors.
//!
//! (Adaptive voxels with the planes' uncertainty: Yuan et al., "Efficient and Probabilistic Adaptive Voxel Mapping for
//! Accurate Online LiDAR Odometry", RA-L 2022.)

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tsdfuse::eigen::eigen;

/// How many sizes of cells there are.
pub(crate) const LEVELS: usize = 5;

/// A cell takes no more points than this: what was seen first, with the least drift, stays.
const MOST_POINTS: f64 = 4000.0;

/// Points that a plane is made of at least.
const LEAST_POINTS: f64 = 8.0;

/// Points whose noise is assumed in a plane beside its own, so that few points that happen to lie flat are no exact plane.
const PRIOR_POINTS: f64 = 6.0;

/// A plane is at most this thick, as a share of its cell (standard deviation across it).
const THICKEST: f64 = 0.1;

/// The plane's second widest direction is at least this many times as wide as the plane is thick.
const LEAST_WIDTH: f64 = 3.0;

/// Number, sum and products of points, relative to the centre of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sums {
    n: f64,
    sum: DVec3,
    /// xx, yy, zz
    squares: DVec3,
    /// yz, zx, xy
    mixed: DVec3,
}

impl Sums {
    fn add(&mut self, p: DVec3) {
        self.n += 1.0;
        self.sum += p;
        self.squares += p * p;
        self.mixed += mixed(p, p);
    }

    /// Adds the points of sums whose origin lies at `shift` from this one's.
    fn add_all(&mut self, other: &Self, shift: DVec3) {
        self.n += other.n;
        self.squares += other.squares + shift * (2.0 * other.sum + shift * other.n);
        self.mixed += other.mixed + mixed(shift, other.sum) + mixed(other.sum, shift) + mixed(shift, shift) * other.n;
        self.sum += other.sum + shift * other.n;
    }

    /// The plane of the points, `centre` being the cell's; `noise` is the standard deviation of a return.
    fn plane(&self, centre: DVec3, size: f64, noise: f64) -> Option<Plane> {
        if self.n < LEAST_POINTS {
            return None;
        }
        let mean = self.sum / self.n;
        let squares = self.squares / self.n - mean * mean;
        let m = self.mixed / self.n - DVec3::new(mean.y * mean.z, mean.z * mean.x, mean.x * mean.y);
        let covariance = DMat3::from_cols(
            DVec3::new(squares.x, m.z, m.y),
            DVec3::new(m.z, squares.y, m.x),
            DVec3::new(m.y, m.x, squares.z),
        );
        let eigen = eigen(&covariance);
        let [thin, mid, wide] = eigen.values.map(|value| value.max(0.0));
        // Three of the points' freedoms are the plane's.
        let variance = (thin * self.n + PRIOR_POINTS * noise * noise) / (self.n - 3.0 + PRIOR_POINTS);
        let is_plane = variance < (THICKEST * size).powi(2) && mid > LEAST_WIDTH.powi(2) * variance;
        is_plane.then(|| Plane {
            mean: centre + mean,
            normal: eigen.vectors[0],
            along: [eigen.vectors[1] / mid.sqrt(), eigen.vectors[2] / wide.sqrt()],
            variance,
            share: 1.0 / self.n,
        })
    }
}

/// (yz, zx, xy) of the products of two vectors, not symmetrised.
fn mixed(a: DVec3, b: DVec3) -> DVec3 {
    DVec3::new(a.y * b.z, a.z * b.x, a.x * b.y)
}

/// The plane of a cell's points, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    pub(crate) mean: DVec3,
    /// Of length 1; which of the two sides it points to means nothing.
    pub(crate) normal: DVec3,
    /// The two directions within the plane, divided by the points' standard deviation along each.
    along: [DVec3; 2],
    /// Of the points across the plane, m².
    pub(crate) variance: f64,
    /// One over the number of points.
    share: f64,
}

impl Plane {
    /// How far a point lies off the plane, metres, and the variance of that: of the point's own noise, of the plane's place
    /// and of its slope, which counts the more the farther the point lies from the middle of the others.
    pub(crate) fn residual(&self, p: DVec3) -> (f64, f64) {
        let d = p - self.mean;
        let lever = 1.0 + self.along[0].dot(d).powi(2) + self.along[1].dot(d).powi(2);
        (self.normal.dot(d), self.variance * (1.0 + self.share * lever))
    }
}

/// The number of a cube along each axis.
pub(crate) type Key = [i32; 3];

/// What a cube is found by. Cubes half a million metres apart share it, which no sensor sees at once.
fn packed([x, y, z]: Key) -> u64 {
    let bits = |v: i32| u64::from(v as u32 & 0x1f_ffff);
    bits(x) << 42 | bits(y) << 21 | bits(z)
}

#[derive(Clone, Copy, Debug)]
struct Cell {
    key: Key,
    sums: Sums,
    /// Points when the plane was fitted last.
    fitted: f64,
    plane: Option<Plane>,
    /// How far the sensor had moved when points were added last, metres.
    seen_at: f64,
}

/// The cells of one size.
#[derive(Clone, Debug)]
struct Level {
    size: f64,
    index: FxHashMap<u64, u32>,
    cells: Vec<Cell>,
    /// Cells that changed since planes were fitted.
    touched: Vec<u32>,
}

impl Level {
    fn key(&self, p: DVec3) -> Key {
        (p / self.size).floor().to_array().map(|v| v as i32)
    }

    fn centre(&self, key: Key) -> DVec3 {
        (DVec3::from_array(key.map(f64::from)) + 0.5) * self.size
    }

    fn get(&self, key: Key) -> Option<&Cell> {
        let &i = self.index.get(&packed(key))?;
        self.cells.get(i as usize)
    }

    fn plane_at(&self, p: DVec3) -> Option<&Plane> {
        self.get(self.key(p))?.plane.as_ref()
    }

    /// Adds what was seen in smaller cells.
    fn add(&mut self, seen: &[(Key, Sums)], seen_size: f64, driven: f64) {
        let shift = (self.size / seen_size).round() as i32;
        for (small, sums) in seen {
            let key = small.map(|v| v.div_euclid(shift));
            let centre = self.centre(key);
            let from = (DVec3::from_array(small.map(f64::from)) + 0.5) * seen_size;
            let i = *self.index.entry(packed(key)).or_insert_with(|| {
                self.cells.push(Cell {
                    key,
                    sums: Sums::default(),
                    fitted: 0.0,
                    plane: None,
                    seen_at: driven,
                });
                self.cells.len() as u32 - 1
            });
            let cell = &mut self.cells[i as usize];
            cell.seen_at = driven;
            if cell.key != key || cell.sums.n >= MOST_POINTS {
                continue;
            }
            cell.sums.add_all(sums, from - centre);
            // Later points change little.
            if cell.fitted >= 0.0 && cell.sums.n >= LEAST_POINTS && cell.sums.n > 1.1 * cell.fitted {
                cell.fitted = -1.0;
                self.touched.push(i);
            }
        }
    }

    fn fit(&mut self, noise: f64) {
        let touched = std::mem::take(&mut self.touched);
        let fit = |i: &u32| {
            let cell = &self.cells[*i as usize];
            cell.sums.plane(self.centre(cell.key), self.size, noise)
        };
        let planes: Vec<Option<Plane>> = touched.par_iter().with_min_len(256).map(fit).collect();
        for (i, plane) in touched.into_iter().zip(planes) {
            let cell = &mut self.cells[i as usize];
            cell.fitted = cell.sums.n;
            cell.plane = plane;
        }
    }

    fn forget(&mut self, centre: DVec3, radius: f64, seen_since: f64) {
        let (size, limit) = (self.size, (radius + self.size).powi(2));
        let is_kept = |cell: &Cell| {
            let at = (DVec3::from_array(cell.key.map(f64::from)) + 0.5) * size;
            cell.seen_at >= seen_since && at.distance_squared(centre) < limit
        };
        self.cells.retain(is_kept);
        self.index.clear();
        let entries = self.cells.iter().zip(0..).map(|(cell, i)| (packed(cell.key), i));
        self.index.extend(entries);
    }
}

/// The points of one scan, in the smallest cells, in order of their first points.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen(pub(crate) Vec<(Key, Sums)>);

/// The world in cells of [`LEVELS`] sizes.
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    levels: Vec<Level>,
    /// Standard deviation of a return, metres.
    noise: f64,
}

impl Cells {
    /// No cells; the smallest ones will measure `size` metres.
    pub(crate) fn new(size: f64, noise: f64) -> Self {
        let level = |k: usize| Level {
            size: size * f64::from(1 << k),
            index: FxHashMap::default(),
            cells: Vec::new(),
            touched: Vec::new(),
        };
        Self {
            levels: (0..LEVELS).map(level).collect(),
            noise,
        }
    }

    /// Sorts points of the world into the smallest cells.
    pub(crate) fn seen(&self, points: impl Iterator<Item = DVec3>) -> Seen {
        let mut index: FxHashMap<u64, u32> = FxHashMap::default();
        let mut seen: Vec<(Key, Sums)> = Vec::new();
        let smallest = &self.levels[0];
        for p in points {
            let key = smallest.key(p);
            let i = *index.entry(packed(key)).or_insert_with(|| {
                seen.push((key, Sums::default()));
                seen.len() as u32 - 1
            });
            seen[i as usize].1.add(p - smallest.centre(key));
        }
        Seen(seen)
    }

    /// Adds points that were seen when the sensor had moved by `driven` metres.
    pub(crate) fn add(&mut self, seen: &Seen, driven: f64) {
        let (size, noise) = (self.levels[0].size, self.noise);
        self.levels.par_iter_mut().for_each(|level| {
            level.add(&seen.0, size, driven);
            level.fit(noise);
        });
    }

    /// The plane that foretells a point best, among those of the cells that it lies in.
    pub(crate) fn plane_at(&self, p: DVec3) -> Option<(&Plane, f64, f64)> {
        let planes = self.levels.iter().filter_map(|level| level.plane_at(p));
        let told = planes.map(|plane| {
            let (residual, variance) = plane.residual(p);
            (plane, residual, variance)
        });
        told.min_by(|a, b| a.2.total_cmp(&b.2))
    }

    /// Forgets the cells that are farther from a point than `radius`, and those without points since the sensor had moved by
    /// `seen_since`.
    pub(crate) fn forget(&mut self, centre: DVec3, radius: f64, seen_since: f64) {
        self.levels
            .par_iter_mut()
            .for_each(|level| level.forget(centre, radius, seen_since));
    }

    /// How many cells there are, of all sizes.
    pub(crate) fn len(&self) -> usize {
        self.levels.iter().map(|level| level.cells.len()).sum()
    }
}
