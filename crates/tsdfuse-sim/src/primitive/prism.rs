//! A polygon, extruded.

use glam::{DVec2, DVec3, dvec3};

use super::facets::Facets;
use super::ray::{Aabb, Entry, Ray};
use super::solid::Solid;

/// (x, y) within a simple polygon, |z| ≤ half.
#[derive(Clone, Debug)]
pub(super) struct Prism {
    /// Counter-clockwise.
    outline: Vec<DVec2>,
    half: f64,
}

impl Prism {
    /// From the corners of a simple polygon, either way round.
    pub(super) fn new(mut outline: Vec<DVec2>, half: f64) -> Self {
        if edges(&outline).map(|(a, b)| a.perp_dot(b)).sum::<f64>() < 0.0 {
            outline.reverse();
        }
        Self { outline, half }
    }

    /// Whether a point of the xy plane is within the outline: crossings of the ray along +x, counted.
    fn covers(&self, p: DVec2) -> bool {
        edges(&self.outline)
            .filter(|(a, b)| (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x))
            .count()
            % 2
            == 1
    }
}

fn edges(outline: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
    outline.iter().copied().zip(outline.iter().copied().cycle().skip(1))
}

fn outward(a: DVec2, b: DVec2) -> DVec2 {
    -(b - a).perp().normalize_or_zero()
}

impl Solid for Prism {
    fn distance(&self, p: DVec3) -> f64 {
        let q = p.truncate();
        let to_outline = edges(&self.outline)
            .map(|(a, b)| {
                let edge = b - a;
                let s = ((q - a).dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
                (a + edge * s).distance_squared(q)
            })
            .fold(f64::INFINITY, f64::min)
            .sqrt();
        let across = if self.covers(q) { -to_outline } else { to_outline };
        let along = p.z.abs() - self.half;
        across.max(along).min(0.0) + across.max(0.0).hypot(along.max(0.0))
    }

    fn enter(&self, ray: &Ray) -> Option<Entry> {
        let (o, d) = (ray.origin.truncate(), ray.direction.truncate());
        let mut best: Option<Entry> = None;
        let mut offer = |t: f64, normal: DVec3| {
            if t > ray.from && best.is_none_or(|b| t < b.t) {
                best = Some(Entry { t, normal });
            }
        };
        let side = -ray.direction.z.signum();
        let t = (side * self.half - ray.origin.z) * ray.inverse.z;
        if self.covers(o + d * t) {
            offer(t, DVec3::Z * side);
        }
        for (a, b) in edges(&self.outline) {
            let edge = b - a;
            // d × edge < 0: the ray crosses from the right of the edge, outside, to its left.
            let turn = d.perp_dot(edge);
            if turn < 0.0 {
                let t = (a - o).perp_dot(edge) / turn;
                let s = (a - o).perp_dot(d) / turn;
                if (0.0..=1.0).contains(&s) && (ray.origin.z + ray.direction.z * t).abs() <= self.half {
                    offer(t, outward(a, b).extend(0.0));
                }
            }
        }
        best
    }

    fn bounds(&self) -> Aabb {
        let low = self.outline.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = self.outline.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        Aabb {
            min: low.extend(-self.half),
            max: high.extend(self.half),
        }
    }

    fn tessellate(&self, _chord_m: f64, out: &mut Facets) {
        for (a, b) in edges(&self.outline) {
            let corners = [(a, -1.0), (b, -1.0), (b, 1.0), (a, 1.0)].map(|(p, z)| p.extend(z * self.half));
            out.polygon(&corners, outward(a, b).extend(0.0));
        }
        for triangle in triangulate(&self.outline) {
            out.polygon(&triangle.map(|p| p.extend(self.half)), DVec3::Z);
            let [a, b, c] = triangle;
            out.polygon(&[a, c, b].map(|p| p.extend(-self.half)), dvec3(0.0, 0.0, -1.0));
        }
    }
}

/// Triangles of a simple counter-clockwise polygon, by cutting off ears.
fn triangulate(outline: &[DVec2]) -> Vec<[DVec2; 3]> {
    let mut rest = outline.to_vec();
    let mut triangles = Vec::new();
    while rest.len() >= 3 {
        let n = rest.len();
        let corners = |i: usize| [rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]];
        let is_ear = |&i: &usize| {
            let [a, b, c] = corners(i);
            let left = |p: DVec2, q: DVec2, r: DVec2| (q - p).perp_dot(r - p);
            let within = |p: &DVec2| {
                ![a, b, c].contains(p) && left(a, b, *p) >= 0.0 && left(b, c, *p) >= 0.0 && left(c, a, *p) >= 0.0
            };
            left(a, b, c) > 0.0 && !rest.iter().any(within)
        };
        // What has no ear left is a line.
        let Some(ear) = (0..n).find(is_ear) else { break };
        triangles.push(corners(ear));
        rest.remove(ear);
    }
    triangles
}
