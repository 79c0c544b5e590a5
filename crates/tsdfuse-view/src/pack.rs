//! Pieces of a surface as bytes that compress well.
//!
//! ```text
//!   u32 vertices, triangles, 1 if coloured; i32 x, y, z: the piece's origin in steps from the scene's     (little-endian)
//!   for x, y, z: low bytes of all vertices, then high bytes: zigzag of the difference to the vertex before, in steps
//!   for u, v:    normals on the octahedron, difference to the vertex before
//!   for r, g, b (if coloured), and for each channel: difference to the vertex before
//!   low bytes of all corners, then high bytes: how far the corner's vertex lies behind the next new one; 0: it is that one
//! ```
//!
//! Vertices are numbered in the order in which triangles first use them, which is what the last line rests on.

use tsdfuse::glam::{IVec3, Vec3};

/// Vertices that a piece has at most.
pub const MOST_VERTICES: usize = 1 << 16;

/// A piece of a surface: triangles of vertices in steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Piece {
    /// Steps from the scene's origin.
    pub origin: IVec3,
    /// Steps from the piece's origin.
    pub positions: Vec<[u16; 3]>,
    /// Normals on the octahedron ([`octahedral`]).
    pub normals: Vec<[u8; 2]>,
    /// sRGB; empty if there are none.
    pub colors: Vec<[u8; 3]>,
    /// Numbers in 256 steps.
    pub channels: Vec<Vec<u8>>,
    /// Three vertex numbers each; a vertex that was not used yet is the next one.
    pub triangles: Vec<[u32; 3]>,
}

impl Piece {
    /// Appends its bytes.
    pub fn pack(&self, out: &mut Vec<u8>) {
        let head = [
            self.positions.len() as u32,
            self.triangles.len() as u32,
            u32::from(!self.colors.is_empty()),
        ];
        head.iter().for_each(|n| out.extend(n.to_le_bytes()));
        self.origin.to_array().iter().for_each(|n| out.extend(n.to_le_bytes()));
        for axis in 0..3 {
            let deltas = || zigzag(self.positions.iter().map(move |position| position[axis]));
            out.extend(deltas().map(|delta| delta as u8));
            out.extend(deltas().map(|delta| (delta >> 8) as u8));
        }
        (0..2).for_each(|axis| out.extend(differences(self.normals.iter().map(move |normal| normal[axis]))));
        if !self.colors.is_empty() {
            (0..3).for_each(|band| out.extend(differences(self.colors.iter().map(move |color| color[band]))));
        }
        for channel in &self.channels {
            out.extend(differences(channel.iter().copied()));
        }
        let corners = || {
            let mut next = 0;
            self.triangles.as_flattened().iter().map(move |&corner| {
                let back = next - corner;
                next += u32::from(back == 0);
                back
            })
        };
        out.extend(corners().map(|back| back as u8));
        out.extend(corners().map(|back| (back >> 8) as u8));
    }
}

/// Differences between neighbours; small ones, whatever their sign, are small numbers.
fn zigzag(values: impl Iterator<Item = u16>) -> impl Iterator<Item = u16> {
    let mut last = 0_u16;
    values.map(move |value| {
        let delta = value.wrapping_sub(last) as i16;
        last = value;
        ((delta << 1) ^ (delta >> 15)) as u16
    })
}

fn differences(values: impl Iterator<Item = u8>) -> impl Iterator<Item = u8> {
    let mut last = 0_u8;
    values.map(move |value| {
        let delta = value.wrapping_sub(last);
        last = value;
        delta
    })
}

/// A unit vector on the octahedron, its lower half folded outward, in 254 steps (Cigolle et al. 2014, "A Survey of Efficient
/// Representations for Independent Unit Vectors").
pub fn octahedral(normal: Vec3) -> [u8; 2] {
    let on = normal / normal.abs().element_sum().max(f32::MIN_POSITIVE);
    let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
    let [u, v] = if on.z < 0.0 {
        [(1.0 - on.y.abs()) * sign(on.x), (1.0 - on.x.abs()) * sign(on.y)]
    } else {
        [on.x, on.y]
    };
    [u, v].map(|x| (x * 127.0 + 127.5) as u8)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The page's decoder, written down once more.
    pub(crate) fn unpack(bytes: &[u8], channels: usize) -> Piece {
        let word = |at: usize| u32::from_le_bytes(bytes[4 * at..][..4].try_into().unwrap());
        let (vertices, triangles, colored) = (word(0) as usize, word(1) as usize, word(2));
        let origin = IVec3::from_array([3, 4, 5].map(|at| word(at) as i32));
        let mut rest = &bytes[24..];
        let mut plane = |n: usize| {
            let (plane, after) = rest.split_at(n);
            rest = after;
            plane
        };
        let mut positions = vec![[0; 3]; vertices];
        for axis in 0..3 {
            let (low, high) = (plane(vertices), plane(vertices));
            let mut last = 0_u16;
            for (i, position) in positions.iter_mut().enumerate() {
                let zigzag = u16::from_le_bytes([low[i], high[i]]);
                last = last.wrapping_add((zigzag >> 1) ^ (zigzag & 1).wrapping_neg());
                position[axis] = last;
            }
        }
        let mut sums = |width: usize| {
            let planes: Vec<Vec<u8>> = (0..width)
                .map(|_| {
                    let deltas = plane(vertices).iter();
                    deltas
                        .scan(0_u8, |last, &delta| {
                            *last = last.wrapping_add(delta);
                            Some(*last)
                        })
                        .collect()
                })
                .collect();
            planes
        };
        let [u, v] = sums(2).try_into().unwrap();
        let normals = std::iter::zip(u, v).map(|(u, v)| [u, v]).collect();
        let colors = match colored {
            0 => Vec::new(),
            _ => {
                let bands = sums(3);
                (0..vertices).map(|i| [bands[0][i], bands[1][i], bands[2][i]]).collect()
            }
        };
        let channels = sums(channels);
        let (low, high) = (plane(3 * triangles), plane(3 * triangles));
        let mut next = 0;
        let corners = std::iter::zip(low, high).map(|(&low, &high)| {
            let back = u32::from(u16::from_le_bytes([low, high]));
            let corner = next - back;
            next += u32::from(back == 0);
            corner
        });
        let corners: Vec<u32> = corners.collect();
        assert!(rest.is_empty());
        Piece {
            origin,
            positions,
            normals,
            colors,
            channels,
            triangles: corners.as_chunks().0.to_vec(),
        }
    }

    #[test]
    fn normals_come_back_within_a_degree() {
        for i in 0..2000 {
            // Along a spiral from pole to pole.
            let (z, turn) = (1.0 - i as f32 / 1000.0, 0.37 * i as f32);
            let normal = Vec3::new(turn.cos(), turn.sin(), 0.0) * (1.0 - z * z).max(0.0).sqrt() + Vec3::Z * z;
            let [mut x, mut y] = octahedral(normal).map(|byte| f32::from(byte) / 127.0 - 1.0);
            let z = 1.0 - x.abs() - y.abs();
            if z < 0.0 {
                (x, y) = ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y));
            }
            let back = Vec3::new(x, y, z).normalize();
            assert!(back.dot(normal) > 1f32.to_radians().cos(), "{normal} became {back}");
        }
    }

    proptest! {
        #[test]
        fn what_is_packed_is_unpacked(
            seed in prop::collection::vec((any::<[u16; 3]>(), any::<[u8; 2]>(), any::<[u8; 3]>(), any::<u8>()), 3..40),
            picks in prop::collection::vec(any::<[prop::sample::Index; 3]>(), 0..60),
            origin in any::<[i32; 3]>(), colored in any::<bool>(),
        ) {
            // Renumbered by first use, as pieces are.
            let mut numbers = vec![u32::MAX; seed.len()];
            let mut used = Vec::new();
            let triangles: Vec<[u32; 3]> = picks.iter().map(|corners| corners.map(|pick| {
                let vertex = pick.index(seed.len());
                if numbers[vertex] == u32::MAX {
                    numbers[vertex] = used.len() as u32;
                    used.push(vertex);
                }
                numbers[vertex]
            })).collect();
            let piece = Piece {
                origin: IVec3::from_array(origin),
                positions: used.iter().map(|&v| seed[v].0).collect(),
                normals: used.iter().map(|&v| seed[v].1).collect(),
                colors: used.iter().filter(|_| colored).map(|&v| seed[v].2).collect(),
                channels: vec![used.iter().map(|&v| seed[v].3).collect()],
                triangles,
            };
            let mut bytes = Vec::new();
            piece.pack(&mut bytes);
            let back = unpack(&bytes, 1);
            prop_assert_eq!(piece, back);
        }
    }
}
