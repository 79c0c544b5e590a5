//! The true surface that was hit: what a reconstruction of the sequence can be complete about.

use std::collections::HashSet;

use glam::{DVec3, I64Vec3};
use tsdfuse::{Mesh, Scan};

/// Edge of the cells that keep one hit each, metres.
const CELL_M: f64 = 0.05;

/// Hits in the world, the first one in each cell of 5 cm.
#[derive(Debug, Default)]
pub struct Hits {
    seen: HashSet<I64Vec3>,
    points: Vec<DVec3>,
}

impl Hits {
    /// Adds the returns of a scan without noise.
    pub fn add(&mut self, scan: &Scan) {
        for hit in scan.points_in_world().into_iter().flatten() {
            if self.seen.insert((hit / CELL_M).floor().as_i64vec3()) {
                self.points.push(hit);
            }
        }
    }

    /// The hits as vertices without triangles.
    pub fn into_cloud(self) -> Mesh {
        Mesh {
            vertices: self.points,
            ..Default::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use tsdfuse::Pose;

    #[test]
    fn each_cell_keeps_its_first_hit() {
        let mut hits = Hits::default();
        let scan = |points: &[[f32; 3]], x: f64| Scan {
            points: points.iter().map(|p| Vec3::from(*p)).collect(),
            pose: Some(Pose {
                translation: DVec3::X * x,
                ..Pose::IDENTITY
            }),
            ..Default::default()
        };
        hits.add(&scan(
            &[[1.01, 0.01, 0.01], [1.03, 0.02, 0.02], [1.01, -0.01, 0.01]],
            0.0,
        ));
        hits.add(&scan(&[[1.02, 0.01, 0.01], [1.02, 0.01, 0.01]], 0.005)); // the first cell again
        hits.add(&scan(&[[1.01, 0.01, 0.01]], 0.05));
        let kept = hits.into_cloud().vertices;
        let wanted = [[1.01, 0.01, 0.01], [1.01, -0.01, 0.01], [1.06, 0.01, 0.01]].map(DVec3::from);
        assert_eq!(kept.len(), wanted.len());
        for (kept, wanted) in kept.iter().zip(wanted) {
            assert!(kept.distance(wanted) < 1e-6, "{kept} {wanted}");
        }
    }
}
