//! A mesh as pieces: near triangles together, each piece small enough for 16 bits a coordinate and a vertex number.

use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::{DVec3, IVec3, Vec3};

use crate::pack::{MOST_VERTICES, Piece, octahedral};
use crate::scene::Surface;

/// Triangles of a piece, about: few enough to find the one under the pointer quickly, and many enough to draw quickly.
const TRIANGLES: usize = 40_000;

/// The lattice that vertices are moved to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    /// World, metres.
    pub(crate) origin: DVec3,
    pub(crate) step_m: f64,
}

/// Steps are finer than this, metres, unless triangles are tens of metres large.
const STEP_M: f64 = 1e-3;

impl Lattice {
    /// For a mesh: whole metres as the origin, and steps that are fine but leave room for any triangle in a piece.
    pub(crate) fn of(mesh: &Mesh) -> Self {
        let [low, high] = bounds(mesh);
        let edge = |[a, b]: [u32; 2]| {
            (mesh.vertices[a as usize] - mesh.vertices[b as usize])
                .abs()
                .max_element()
        };
        let longest = |&[a, b, c]: &[u32; 3]| edge([a, b]).max(edge([b, c])).max(edge([c, a]));
        let longest = mesh.triangles.par_iter().map(longest).reduce(|| 0.0, f64::max);
        let fine = STEP_M.min((high - low).length() / f64::from(1 << 16));
        Self {
            origin: ((low + high) / 2.0).round(),
            step_m: fine.max(longest / 65_000.0).max(f64::MIN_POSITIVE),
        }
    }

    pub(crate) fn steps(&self, vertex: DVec3) -> IVec3 {
        let steps = (vertex - self.origin) * self.step_m.recip();
        // Rounded; the function for it is slow without SSE4.1.
        (steps + steps.signum() * 0.5).as_ivec3()
    }
}

/// The lowest and the highest coordinates of a mesh; 0 of an empty one.
pub(crate) fn bounds(mesh: &Mesh) -> [DVec3; 2] {
    let corners = mesh.vertices.par_iter().map(|&vertex| [vertex, vertex]);
    let both = corners.reduce_with(|[a, b], [c, d]| [a.min(c), b.max(d)]);
    both.unwrap_or_default()
}

/// Divides a mesh into pieces. Vertices on their borders are in several of them, at the same place.
pub(crate) fn pieces(surface: &Surface<'_>, lattice: &Lattice) -> Vec<Piece> {
    let mesh = surface.mesh;
    let steps: Vec<IVec3> = mesh.vertices.par_iter().map(|vertex| lattice.steps(*vertex)).collect();
    let middle = |[a, b, c]: [u32; 3]| (steps[a as usize] + steps[b as usize] + steps[c as usize]) / 3;
    let middles: Vec<IVec3> = mesh.triangles.par_iter().map(|corners| middle(*corners)).collect();
    let groups = divide((0..mesh.triangles.len() as u32).collect(), &middles);
    let scratch = || vec![u32::MAX; mesh.vertices.len()];
    let nested = groups.into_par_iter().map_init(scratch, |numbers, triangles| {
        piece_or_halves(surface, &steps, &middles, &triangles, numbers)
    });
    nested.flatten_iter().collect()
}

/// Groups of triangles by halving the longest extent.
fn divide(triangles: Vec<u32>, middles: &[IVec3]) -> Vec<Vec<u32>> {
    if triangles.len() <= TRIANGLES {
        return if triangles.is_empty() {
            Vec::new()
        } else {
            vec![triangles]
        };
    }
    let [left, right] = halves(&triangles, middles);
    let (mut left, right) = rayon::join(|| divide(left, middles), || divide(right, middles));
    left.extend(right);
    left
}

/// Both halves of a group, each in the order that it was in.
fn halves(triangles: &[u32], middles: &[IVec3]) -> [Vec<u32>; 2] {
    let places = || triangles.iter().map(|&t| middles[t as usize]);
    let low = places().reduce(IVec3::min).unwrap_or_default();
    let high = places().reduce(IVec3::max).unwrap_or_default();
    let extent = (high.as_i64vec3() - low.as_i64vec3()).to_array();
    let axis = (0..3).max_by_key(|&axis| extent[axis]).unwrap_or_default();
    let mut along: Vec<i32> = places().map(|place| place[axis]).collect();
    let half = along.len() / 2;
    let (_, &mut cut, _) = along.select_nth_unstable(half);
    let (left, right): (Vec<u32>, Vec<u32>) = triangles.iter().partition(|&&t| middles[t as usize][axis] < cut);
    if !left.is_empty() {
        return [left, right];
    }
    // All lie at one place, or most of them do: any halves will do.
    let (left, right) = triangles.split_at(half);
    [left.to_vec(), right.to_vec()]
}

/// The piece of a group of triangles, or several where one has no room for them.
fn piece_or_halves(
    surface: &Surface<'_>,
    steps: &[IVec3],
    middles: &[IVec3],
    triangles: &[u32],
    numbers: &mut [u32],
) -> Vec<Piece> {
    if let Some(piece) = piece(surface, steps, triangles, numbers) {
        return vec![piece];
    }
    if triangles.len() < 2 {
        return Vec::new(); // the lattice has room for any triangle
    }
    let mut all = Vec::new();
    for half in halves(triangles, middles) {
        all.extend(piece_or_halves(surface, steps, middles, &half, numbers));
    }
    all
}

/// `None`: more vertices or steps than a piece has room for. `numbers` is `u32::MAX` everywhere, before and after.
fn piece(surface: &Surface<'_>, steps: &[IVec3], triangles: &[u32], numbers: &mut [u32]) -> Option<Piece> {
    let mesh = surface.mesh;
    let mut used: Vec<u32> = Vec::with_capacity(triangles.len());
    let renumber = |&triangle: &u32| {
        mesh.triangles[triangle as usize].map(|vertex| {
            let number = &mut numbers[vertex as usize];
            if *number == u32::MAX {
                *number = used.len() as u32;
                used.push(vertex);
            }
            *number
        })
    };
    let renumbered: Vec<[u32; 3]> = triangles.iter().map(renumber).collect();
    used.iter().for_each(|&vertex| numbers[vertex as usize] = u32::MAX);
    let places = || used.iter().map(|&vertex| steps[vertex as usize]);
    let (low, high) = (places().reduce(IVec3::min)?, places().reduce(IVec3::max)?);
    let extent = high.as_i64vec3() - low.as_i64vec3();
    if used.len() > MOST_VERTICES || extent.max_element() > i64::from(u16::MAX) {
        return None;
    }
    let paint = &surface.paint;
    let of = |values: &[[u8; 3]]| used.iter().filter_map(|&v| values.get(v as usize).copied()).collect();
    let quantised = |(channel, values): &(crate::Channel, &[f32])| {
        let value = |&v: &u32| channel.quantised(values.get(v as usize).copied().unwrap_or_default());
        used.iter().map(value).collect()
    };
    Some(Piece {
        origin: low,
        positions: places()
            .map(|place| (place - low).to_array().map(|n| n as u16))
            .collect(),
        normals: used
            .iter()
            .map(|&v| octahedral(mesh.normals.get(v as usize).copied().unwrap_or(Vec3::Z)))
            .collect(),
        colors: of(paint.colors),
        channels: paint.channels.iter().map(quantised).collect(),
        triangles: renumbered,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Channel, Paint, Ramp};

    /// A lattice of hills, of `n` by `n` vertices, far from the origin.
    pub(crate) fn hills(n: u32) -> Mesh {
        let place = |i: u32| {
            let (x, y) = (f64::from(i % n) * 0.05, f64::from(i / n) * 0.05);
            DVec3::new(
                691_000.0 + x,
                5_335_000.0 + y,
                500.0 + (x * 0.7).sin() + (y * 0.5).cos(),
            )
        };
        let quads = (0..(n - 1) * (n - 1)).map(|i| i % (n - 1) + i / (n - 1) * n);
        Mesh {
            vertices: (0..n * n).map(place).collect(),
            normals: vec![Vec3::Z; (n * n) as usize],
            triangles: quads
                .flat_map(|i| [[i, i + 1, i + n], [i + 1, i + n + 1, i + n]])
                .collect(),
        }
    }

    /// Corners of triangles in steps, sorted: what is shown, however it is divided.
    fn shown(triangles: impl Iterator<Item = [IVec3; 3]>) -> Vec<[[i32; 3]; 3]> {
        let mut all: Vec<_> = triangles
            .map(|corners| corners.map(|corner| corner.to_array()))
            .collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn pieces_hold_each_triangle_once_and_what_belongs_to_its_vertices() {
        let mesh = hills(400);
        let lattice = Lattice::of(&mesh);
        let heights: Vec<f32> = mesh.vertices.iter().map(|v| (v.z - 500.0) as f32).collect();
        let colors: Vec<[u8; 3]> = (0..mesh.vertices.len()).map(|i| [i as u8, (i >> 8) as u8, 7]).collect();
        let channel = Channel {
            name: "height".into(),
            unit: "m".into(),
            low: -2.0,
            high: 2.0,
            ramp: Ramp::Turbo,
            first: false,
        };
        let channels = [(channel.clone(), heights.as_slice())];
        let paint = Paint {
            colors: &colors,
            channels: &channels,
        };
        let pieces = pieces(&Surface { mesh: &mesh, paint }, &lattice);
        assert!(pieces.len() > 4, "{}", pieces.len());
        let of_pieces = pieces.iter().flat_map(|piece| {
            let corner = |v: u32| piece.origin + IVec3::from_array(piece.positions[v as usize].map(i32::from));
            piece.triangles.iter().map(move |corners| corners.map(corner))
        });
        let of_mesh = mesh
            .triangles
            .iter()
            .map(|corners| corners.map(|v| lattice.steps(mesh.vertices[v as usize])));
        let (of_pieces, of_mesh) = (shown(of_pieces), shown(of_mesh));
        assert!(of_pieces == of_mesh);
        // Steps are of a millimetre or less, and values of vertices stay theirs.
        assert!(lattice.step_m <= 1e-3);
        for piece in &pieces {
            for ((position, color), byte) in piece.positions.iter().zip(&piece.colors).zip(&piece.channels[0]) {
                let place = piece.origin + IVec3::from_array(position.map(i32::from));
                let height = lattice.origin.z + f64::from(place.z) * lattice.step_m - 500.0;
                assert!((f64::from(*byte) / 255.0 * 4.0 - 2.0 - height).abs() < 0.01);
                assert_eq!(color[2], 7);
            }
        }
    }

    #[test]
    fn triangles_of_any_size_and_all_at_one_place_fit() {
        let vertices = vec![DVec3::ZERO, DVec3::X * 900.0, DVec3::Y * 900.0];
        let mesh = Mesh {
            normals: vec![Vec3::Z; 3],
            vertices,
            triangles: vec![[0, 1, 2]; 100_000],
        };
        let pieces = pieces(&Surface::of(&mesh), &Lattice::of(&mesh));
        assert_eq!(pieces.iter().map(|piece| piece.triangles.len()).sum::<usize>(), 100_000);
    }
}
