//! What tracking knows of the world: cells of several sizes, each with the plane of the points in it.
//!
//! Space is divided into cubes at [`LEVELS`] sizes, each twice the one before. Every cube keeps the number, the sum and the
//! products of its points, and from these the plane with its uncertainty. A point asks the cubes that it lies in, one of each
//! size, and takes the plane that predicts it best: a large one where the surface is flat, so that hundreds of points say
//! where it is, a small one where it is not. Nothing is searched for, and nothing depends on whether the sensor is indoors.
//!
//! (Adaptive voxels with the planes' uncertainty: Yuan et al., "Efficient and Probabilistic Adaptive Voxel Mapping for
//! Accurate Online LiDAR Odometry", RA-L 2022.)

use glam::{DMat3, DVec3, IVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tsdfuse::eigen::eigen;

/// How many sizes of cells there are.
const LEVELS: usize = 5;

/// The level of the largest ones.
const TOP: usize = LEVELS - 1;

/// Points that a plane is made of at least.
const LEAST_POINTS: f64 = 8.0;

/// Points whose noise is assumed in a plane beside its own, so that few points that happen to lie flat are no exact plane.
const PRIOR_POINTS: f64 = 6.0;

/// A plane is at most this thick, as a share of its cell (standard deviation across it).
const THICKEST: f64 = 0.1;

/// The plane's second widest direction is at least this many times as wide as the plane is thick.
const LEAST_WIDTH: f64 = 3.0;

/// The same of one that is wide.
const WIDE: f64 = 4.0;

/// Turns the world so that cells stand on a corner. A wall that lies along a side of its cells, and near it, loses points to the cells beside them by
/// noise, and each of the two planes lies too far inside. Floors and upright walls are oblique to all sides here: by 55° and at least 35°, those
/// along the axes by 38°.
const TURN: DMat3 = {
    const A: f64 = 0.788_675_134_594_812_9;
    const B: f64 = 0.211_324_865_405_187_1;
    const C: f64 = 0.577_350_269_189_625_8;
    DMat3::from_cols_array(&[A, -C, -B, B, C, -A, C, C, C])
};

/// Elevations within such an angle are not told apart, radians.
const ELEVATION_STEP: f32 = 0.005;

/// Elevations at which the points of a plane are seen, at least.
const LEAST_ELEVATIONS: u32 = 2;

/// Cells are split by the hash of the largest one that they lie in, and each part is filled by one thread.
const SHARDS: usize = 16;

/// No child.
const NONE: u32 = u32::MAX;

/// Points that one thread places at a time.
const GRAIN: usize = 1024;

/// Number, sum and products of points, relative to the centre of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    n: f64,
    sum: DVec3,
    /// xx, yy, zz
    squares: DVec3,
    /// yz, zx, xy
    mixed: DVec3,
}

impl Sums {
    /// Adds a point, or takes it away: `sign` is 1 or -1.
    fn add(&mut self, p: DVec3, sign: f64) {
        self.n += sign;
        self.sum += sign * p;
        self.squares += sign * p * p;
        self.mixed += sign * DVec3::new(p.y * p.z, p.z * p.x, p.x * p.y);
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
            slope: [mid, wide].map(|value| 1.0 / self.n + variance / value),
        })
    }
}

/// The plane of a cell's points, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    mean: DVec3,
    /// Of length 1; which of the two sides it points to means nothing.
    pub(crate) normal: DVec3,
    /// The two directions within the plane, divided by the points' standard deviation along each.
    along: [DVec3; 2],
    /// Of the points across the plane, m².
    variance: f64,
    /// One over the number of points.
    share: f64,
    /// The same for its slope along each of `along`: sides cut a plane obliquely, so points before it reach farther to one side and points behind it to
    /// the other, which turns it by about variance / width².
    slope: [f64; 2],
}

impl Plane {
    /// Whether the normal has a share along a direction that its own error does not explain: three standard deviations.
    pub(crate) fn faces(&self, direction: DVec3, least_share: f64) -> bool {
        let error = (self.variance * self.lever(direction)).sqrt();
        self.normal.dot(direction).abs() > least_share + 3.0 * error
    }

    /// Whether the plane is much wider than thick: a line of one beam's points and a few others beside it is not.
    pub(crate) fn is_wide(&self) -> bool {
        self.variance * self.along[0].length_squared() < WIDE.powi(-2)
    }

    /// How far from a point the plane lies along a direction, metres.
    pub(crate) fn distance_along(&self, p: DVec3, direction: DVec3) -> f64 {
        self.normal.dot(self.mean - p) / self.normal.dot(direction)
    }

    /// How far along a direction the middle of the plane's points lies from a point, metres.
    pub(crate) fn ahead(&self, p: DVec3, direction: DVec3) -> f64 {
        direction.dot(self.mean - p)
    }

    /// Whether a point of the plane lies among the points that it was made of.
    pub(crate) fn reaches(&self, p: DVec3) -> bool {
        self.along.iter().all(|along| along.dot(p - self.mean).abs() < 2.5)
    }

    /// How far a point lies off the plane, metres, and the variance of that: of the point's own noise, of the plane's place
    /// and of its slope, which counts the more the farther the point lies from the middle of the others.
    pub(crate) fn residual(&self, p: DVec3) -> (f64, f64) {
        let d = p - self.mean;
        (self.normal.dot(d), self.variance * (1.0 + self.share + self.lever(d)))
    }

    /// What the error of the slope adds to the variance so far from the middle of the points, in variances of a return.
    fn lever(&self, d: DVec3) -> f64 {
        self.slope[0] * self.along[0].dot(d).powi(2) + self.slope[1] * self.along[1].dot(d).powi(2)
    }
}

/// A cube of one of the sizes.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Its number along each axis, in cubes of its size.
    key: IVec3,
    /// The elevations at which its points were seen, as bits.
    elevations: u64,
    /// Whether its points changed since its plane was fitted.
    is_touched: bool,
    level: u8,
    sums: Sums,
    /// Points when the plane was fitted last.
    fitted: f64,
    /// How far the sensor had moved when points were added last, metres.
    seen_at: f64,
}

/// A point that was seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// In the world.
    pub(crate) at: DVec3,
    /// The elevation at which the sensor saw it, as one of 64 bits: see [`elevation_bit`].
    pub(crate) elevation: u64,
}

/// The bit of a point's elevation in the frame of the sensor: the points of one beam of a rotating LiDAR have the same.
pub(crate) fn elevation_bit(p: Vec3) -> u64 {
    let elevation = p.z.atan2(p.truncate().length());
    1 << ((elevation / ELEVATION_STEP).floor() as i64).rem_euclid(64)
}

/// Some of the largest cells, and all smaller ones in them.
#[derive(Clone, Debug, Default)]
struct Shard {
    /// The largest cells by their key.
    roots: FxHashMap<IVec3, u32>,
    cells: Vec<Cell>,
    /// Of each cell its eight parts.
    children: Vec<[u32; 8]>,
    /// Of each cell.
    planes: Vec<Option<Plane>>,
    /// Cells whose points changed since planes were fitted.
    touched: Vec<u32>,
}

/// Which of the eight parts of the cell around it a cell is.
fn octant(key: IVec3) -> usize {
    let bits = key & 1;
    (bits.x | bits.y << 1 | bits.z << 2) as usize
}

/// Sizes and limits.
#[derive(Clone, Copy, Debug)]
struct Grid {
    /// Edge of the smallest cells, metres.
    size: f64,
    /// Standard deviation of a return, metres.
    noise: f64,
    /// A cell takes no more points than this: what was seen first, with the least drift, stays.
    most_points: f64,
    /// Turns the world into the cells' axes.
    turn: DMat3,
}

impl Grid {
    fn size(&self, level: u8) -> f64 {
        self.size * f64::from(1 << level)
    }

    fn centre(&self, key: IVec3, level: u8) -> DVec3 {
        self.turn.transpose() * ((key.as_dvec3() + 0.5) * self.size(level))
    }

    /// The smallest cell around a point.
    fn key(&self, p: DVec3) -> IVec3 {
        (self.turn * p / self.size).floor().as_ivec3()
    }
}

fn shard_of(root: IVec3) -> usize {
    let [x, y, z] = root.to_array().map(|v| v as u32);
    let hash = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ z.wrapping_mul(0xc2b2_ae3d);
    (hash >> 16) as usize % SHARDS
}

impl Shard {
    fn create(&mut self, key: IVec3, level: u8) -> u32 {
        self.cells.push(Cell {
            key,
            elevations: 0,
            is_touched: false,
            level,
            sums: Sums::default(),
            fitted: 0.0,
            seen_at: 0.0,
        });
        self.children.push([NONE; 8]);
        self.planes.push(None);
        self.cells.len() as u32 - 1
    }

    /// Adds a point to the cells that it lies in, or takes it away.
    fn add(&mut self, Seen { at: p, elevation }: Seen, grid: &Grid, sign: f64, driven: f64) {
        let smallest = grid.key(p);
        let root = smallest >> TOP as i32;
        let mut at = match self.roots.get(&root) {
            Some(&at) => at,
            None => {
                let at = self.create(root, TOP as u8);
                self.roots.insert(root, at);
                at
            }
        };
        for level in (0..LEVELS as u8).rev() {
            let cell = &mut self.cells[at as usize];
            cell.seen_at = cell.seen_at.max(driven);
            cell.elevations |= elevation;
            if sign < 0.0 || cell.sums.n < grid.most_points {
                cell.sums.add(p - grid.centre(cell.key, level), sign);
                let n = cell.sums.n;
                // A few more points change little.
                let is_new = sign < 0.0 || (n >= LEAST_POINTS && n > 1.1 * cell.fitted);
                if is_new && !cell.is_touched {
                    cell.is_touched = true;
                    self.touched.push(at);
                }
            }
            if level > 0 {
                let key = smallest >> i32::from(level - 1);
                let child = self.children[at as usize][octant(key)];
                at = if child == NONE {
                    let child = self.create(key, level - 1);
                    self.children[at as usize][octant(key)] = child;
                    child
                } else {
                    child
                };
            }
        }
    }

    fn fit(&mut self, grid: &Grid) {
        for at in self.touched.drain(..) {
            let cell = &mut self.cells[at as usize];
            let (centre, size) = (grid.centre(cell.key, cell.level), grid.size(cell.level));
            (cell.is_touched, cell.fitted) = (false, cell.sums.n);
            // The points of one beam lie in its cone, whatever they lie on.
            let is_known = cell.elevations.count_ones() >= LEAST_ELEVATIONS;
            let plane = || cell.sums.plane(centre, size, grid.noise);
            self.planes[at as usize] = is_known.then(plane).flatten();
        }
    }

    /// Only the cells that are kept, in the order in which they are found from the old ones.
    fn forget(&mut self, is_kept: impl Fn(&Cell) -> bool) {
        let old = std::mem::take(self);
        let roots = old
            .roots
            .values()
            .copied()
            .filter(|&at| is_kept(&old.cells[at as usize]));
        let mut roots: Vec<u32> = roots.collect();
        roots.sort_unstable();
        let mut kept: Vec<(u32, Option<(u32, usize)>)> = roots.into_iter().map(|at| (at, None)).collect();
        let mut next = 0;
        while let Some(&(from, parent)) = kept.get(next) {
            next += 1;
            let (cell, at) = (old.cells[from as usize], self.cells.len() as u32);
            self.cells.push(cell);
            self.children.push([NONE; 8]);
            self.planes.push(old.planes[from as usize]);
            match parent {
                Some((parent, part)) => self.children[parent as usize][part] = at,
                None => drop(self.roots.insert(cell.key, at)),
            }
            let parts = old.children[from as usize].iter().enumerate();
            let parts = parts.filter(|&(_, &child)| child != NONE && is_kept(&old.cells[child as usize]));
            kept.extend(parts.map(|(part, &child)| (child, Some((at, part)))));
        }
    }
}

/// Where a point found its plane. As long as it stays in its smallest cell, it need not look again.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Found {
    key: IVec3,
    /// Shard and cell.
    at: Option<(u32, u32)>,
    is_known: bool,
}

/// The world in cells of [`LEVELS`] sizes.
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    grid: Grid,
    shards: Vec<Shard>,
}

impl Cells {
    /// No cells; the smallest ones will measure `size` metres, and take `most_points` points.
    pub(crate) fn new(size: f64, noise: f64, most_points: f64) -> Self {
        Self {
            grid: Grid {
                size,
                noise,
                most_points,
                turn: TURN,
            },
            shards: vec![Shard::default(); SHARDS],
        }
    }

    /// The same along the axes of the world, for few points: what stands upright is cut less often, but less precise.
    pub(crate) fn upright(size: f64, noise: f64) -> Self {
        let mut cells = Self::new(size, noise, f64::INFINITY);
        cells.grid.turn = DMat3::IDENTITY;
        cells
    }

    /// Adds points that were seen when the sensor had moved by `driven` metres; cells with points that were seen at infinity are never forgotten.
    pub(crate) fn add(&mut self, points: &[Seen], driven: f64) {
        self.change(points, 1.0, driven);
    }

    /// Takes points away that were added.
    pub(crate) fn remove(&mut self, points: &[Seen], driven: f64) {
        self.change(points, -1.0, driven);
    }

    fn change(&mut self, points: &[Seen], sign: f64, driven: f64) {
        let grid = self.grid;
        let shards: Vec<u8> = points
            .par_iter()
            .with_min_len(GRAIN)
            .map(|seen| shard_of(grid.key(seen.at) >> TOP as i32) as u8)
            .collect();
        self.shards.par_iter_mut().enumerate().for_each(|(number, shard)| {
            let own = points.iter().zip(&shards).filter(|(_, s)| usize::from(**s) == number);
            own.for_each(|(&p, _)| shard.add(p, &grid, sign, driven));
            shard.fit(&grid);
        });
    }

    /// The plane that predicts a point best, among those of the cells that it lies in, with the point's distance from it,
    /// metres, and the variance of that.
    pub(crate) fn plane_at(&self, p: DVec3) -> Option<(&Plane, f64, f64)> {
        self.plane_near(p, &mut Found::default())
    }

    /// The same for a point that moves little from time to time: the plane that was best when it came into its smallest cell.
    pub(crate) fn plane_near(&self, p: DVec3, found: &mut Found) -> Option<(&Plane, f64, f64)> {
        let key = self.grid.key(p);
        if !found.is_known || found.key != key {
            let at = self.best(p, key);
            *found = Found {
                key,
                at,
                is_known: true,
            };
        }
        let (shard, at) = found.at?;
        let plane = self.shards[shard as usize].planes[at as usize].as_ref()?;
        let (residual, variance) = plane.residual(p);
        Some((plane, residual, variance))
    }

    /// All planes of the cells that a point lies in, and of those up to `reach` away along a direction, as far as they are planes without what was seen
    /// at some elevations (as bits), too.
    pub(crate) fn planes_along(
        &self,
        p: DVec3,
        direction: DVec3,
        reach: f64,
        without: u64,
        mut each: impl FnMut(&Plane),
    ) {
        let steps = (reach / (0.5 * self.grid.size)).ceil() as i32;
        let mut last = None;
        for k in -steps..=steps {
            let key = self.grid.key(p + direction * (f64::from(k) / f64::from(steps) * reach));
            if last != Some(key) {
                self.planes_of(key, |(shard, at), plane| {
                    let elevations = self.shards[shard as usize].cells[at as usize].elevations;
                    if (elevations & !without).count_ones() >= LEAST_ELEVATIONS {
                        each(plane);
                    }
                });
            }
            last = Some(key);
        }
    }

    /// The planes of a smallest cell and of those around it, the largest first.
    fn planes_of(&self, smallest: IVec3, mut each: impl FnMut((u32, u32), &Plane)) {
        let root = smallest >> TOP as i32;
        let number = shard_of(root);
        let shard = &self.shards[number];
        let Some(&(mut at)) = shard.roots.get(&root) else {
            return;
        };
        for level in (0..LEVELS as i32).rev() {
            if let Some(plane) = &shard.planes[at as usize] {
                each((number as u32, at), plane);
            }
            if level > 0 {
                at = shard.children[at as usize][octant(smallest >> (level - 1))];
                if at == NONE {
                    break;
                }
            }
        }
    }

    /// The plane that predicts a point best.
    fn best(&self, p: DVec3, smallest: IVec3) -> Option<(u32, u32)> {
        let (mut best, mut least) = (None, f64::INFINITY);
        self.planes_of(smallest, |at, plane| {
            let (_, variance) = plane.residual(p);
            // Of equals the smaller one.
            if variance <= least {
                (best, least) = (Some(at), variance);
            }
        });
        best
    }

    /// Forgets the cells that are farther from a point than `radius`, and those without points since the sensor had moved by
    /// `seen_since`.
    pub(crate) fn forget(&mut self, centre: DVec3, radius: f64, seen_since: f64) {
        let grid = self.grid;
        let is_kept = |cell: &Cell| {
            let limit = radius + grid.size(cell.level);
            let is_near = || grid.centre(cell.key, cell.level).distance_squared(centre) < limit * limit;
            cell.seen_at == f64::INFINITY || (cell.seen_at >= seen_since && is_near())
        };
        self.shards.par_iter_mut().for_each(|shard| shard.forget(is_kept));
    }

    /// How many cells there are, of all sizes.
    pub(crate) fn len(&self) -> usize {
        self.shards.iter().map(|shard| shard.cells.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of two walls and a floor, slightly rough.
    fn points() -> Vec<DVec3> {
        let rough = |i: usize| 0.01 * ((i * 7919) as f64).sin();
        let at = |i: usize| {
            (
                ((i * 37) % 400) as f64 * 0.02 - 4.0,
                ((i * 61) % 390) as f64 * 0.02 - 3.9,
            )
        };
        let point = |i: usize| {
            let (a, b) = at(i);
            match i % 3 {
                0 => DVec3::new(a, b, rough(i)),
                1 => DVec3::new(3.3 + rough(i), a, b),
                _ => DVec3::new(a, -2.2 + rough(i), b),
            }
        };
        (0..30_000).map(point).collect()
    }

    /// As seen by two beams.
    fn seen(points: &[DVec3]) -> Vec<Seen> {
        points.iter().map(|&at| Seen { at, elevation: 3 }).collect()
    }

    /// The plane that predicts `p` best, of the cells around it, from all points.
    fn slowly(points: &[DVec3], grid: &Grid, p: DVec3) -> Option<(f64, f64)> {
        let planes = (0..LEVELS as u8).filter_map(|level| {
            let key = grid.key(p) >> i32::from(level);
            let centre = grid.centre(key, level);
            let mut sums = Sums::default();
            let own = points.iter().filter(|q| grid.key(**q) >> i32::from(level) == key);
            own.for_each(|q| sums.add(*q - centre, 1.0));
            let plane = sums.plane(centre, grid.size(level), grid.noise)?;
            Some(plane.residual(p))
        });
        planes.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    #[test]
    fn the_best_plane_is_that_of_all_points_of_the_cells_around() {
        let (points, mut cells) = (points(), Cells::new(0.25, 0.02, f64::INFINITY));
        // More than are kept are added and taken away again.
        let others: Vec<DVec3> = points.iter().map(|p| *p + DVec3::new(0.1, 0.2, 0.3)).collect();
        cells.add(&seen(&points), 0.0);
        cells.add(&seen(&others), 0.0);
        cells.remove(&seen(&others), 0.0);
        let grid = cells.grid;
        let mut planes = 0;
        for p in points.iter().step_by(500).map(|p| *p + DVec3::new(0.03, -0.02, 0.05)) {
            let (found, want) = (cells.plane_at(p), slowly(&points, &grid, p));
            assert_eq!(found.is_some(), want.is_some(), "{p}");
            if let (Some((_, residual, variance)), Some((want, of_that))) = (found, want) {
                planes += 1;
                assert!(
                    (residual.abs() - want.abs()).abs() < 1e-9 && (variance - of_that).abs() < 1e-9,
                    "{p}"
                );
            }
        }
        assert!(planes > 40, "{planes}");
    }

    #[test]
    fn walls_along_the_axes_lie_where_their_points_are() {
        let noise = |i: usize| 0.02 * 3.4 * (((i * 7919) % 1009) as f64 / 1009.0 - 0.5);
        let at = |i: usize| (((i * 37) % 400) as f64 * 0.01, ((i * 61) % 397) as f64 * 0.01);
        for axis in 0..3 {
            let turned = |p: DVec3| DVec3::from_array(std::array::from_fn(|i| p[(i + axis) % 3]));
            let normal = turned(DVec3::X);
            for x in [0.0, 0.01, 0.06, 0.13, 0.5, 0.77, 1.0] {
                let wall = (0..20_000).map(|i| turned(DVec3::new(x + noise(i), at(i).0, at(i).1)));
                let wall: Vec<DVec3> = wall.collect();
                let mut cells = Cells::new(0.25, 0.02, f64::INFINITY);
                cells.add(&seen(&wall), 0.0);
                // How far the planes lie off the wall where its points are.
                let off = wall.iter().step_by(97).filter_map(|p| {
                    let (plane, ..) = cells.plane_at(*p)?;
                    let there = *p + normal * (x - p.dot(normal));
                    let (r, variance) = plane.residual(there);
                    assert!(
                        r * r < 16.0 * (variance - plane.variance),
                        "{axis} {x} {p}: {r} {variance}"
                    );
                    Some(plane.distance_along(there, normal))
                });
                let off: Vec<f64> = off.collect();
                let rms = (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt();
                assert!(off.len() > 200 && rms < 0.0025, "{axis} {x}: {rms}");
            }
        }
    }

    #[test]
    fn what_one_beam_saw_is_no_plane() {
        let mut cells = Cells::new(0.25, 0.02, f64::INFINITY);
        let one: Vec<Seen> = points().iter().map(|&at| Seen { at, elevation: 4 }).collect();
        cells.add(&one, 0.0);
        assert!(one.iter().all(|seen| cells.plane_at(seen.at).is_none()));
        cells.add(&seen(&points()), 0.0);
        assert!(one.iter().any(|seen| cells.plane_at(seen.at).is_some()));
    }

    #[test]
    fn what_is_forgotten_is_gone_and_the_rest_is_as_before() {
        let (points, mut cells) = (points(), Cells::new(0.25, 0.02, f64::INFINITY));
        let far: Vec<DVec3> = points.iter().map(|p| *p + 100.0).collect();
        cells.add(&seen(&points), 0.0);
        let (alone, probes) = (cells.clone(), points.iter().step_by(50));
        cells.add(&seen(&far), 10.0);
        cells.forget(DVec3::ZERO, 50.0, 0.0);
        assert_eq!(cells.len(), alone.len());
        for p in probes {
            assert_eq!(cells.plane_at(*p), alone.plane_at(*p));
            assert!(cells.plane_at(*p + 100.0).is_none());
        }
        cells.forget(DVec3::ZERO, 50.0, 5.0);
        assert_eq!(cells.len(), 0);
    }
}
