//! Local surface normals of one scan, from the neighbours of each return in the organized image.
//!
//! ```text
//!            ring u+1
//!               c
//!             / | \          Adjacent: the four triangles p-a-b, p-b-c, p-c-d, p-d-a
//!   column   d──p──b  column
//!    v−1      \ | /   v+1    Holz: the four quads around p, p-b-·-c and so on, of a mesh without long edges
//!               a
//!            ring u−1
//! ```
//!
//! Columns wrap around, rings do not. Geometry is that of the **deskewed** points, in world axes relative to the scan's
//! pose, while the image tells who is whose neighbour.

mod adjacent;
mod holz;
#[cfg(test)]
mod oracle;

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::sensor::ScanImage;

/// How normals are estimated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NormalsConfig {
    /// The estimator.
    pub estimator: Estimator,
    /// Cosine of the largest angle at which two triangles count as similar; `adjacent` only.
    pub min_dot: f32,
}

impl Default for NormalsConfig {
    fn default() -> Self {
        Self {
            estimator: Estimator::Adjacent,
            min_dot: 0.8,
        }
    }
}

impl NormalsConfig {
    /// Checks the numbers, which may come from a file.
    ///
    /// # Errors
    /// The reason, naming the field.
    pub fn validate(&self) -> Result<(), NormalsError> {
        let possible = (-1.0..1.0).contains(&self.min_dot);
        possible.then_some(()).ok_or(NormalsError::MinDot(self.min_dot))
    }
}

/// Why a configuration of the normals cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NormalsError {
    /// A cosine lies between −1 and 1.
    #[error("normals.min_dot is {0}; a cosine from -1 up to below 1 is possible")]
    MinDot(f32),
}

/// The ways to estimate a normal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// Mean of those of the four adjacent triangles that agree (thesis 5.4.2); all four neighbours must be there.
    #[default]
    Adjacent,
    /// Mean of the adjacent quads of a mesh without long edges (thesis 5.4.1, after Holz and Behnke).
    Holz,
}

/// The surface at one return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Normal {
    /// Unit vector towards the side of the sensor, in the axes of the points; zero where there is none.
    pub normal: Vec3,
    /// w_θ (5.17): 1 where all faces used agree, falling to 0 with the sum of their angles to the normal.
    pub agreement: f32,
}

impl Normal {
    /// Whether there is a normal at all.
    pub fn is_some(&self) -> bool {
        self.normal != Vec3::ZERO
    }
}

/// Estimates the normal of every return.
///
/// `points` are the returns `image` was built from, deskewed: in world axes relative to the scan's pose, metres. `origins`
/// are where their rays began, in the same frame; without them all began at zero. `out` gets one entry per point. The
/// result does not depend on the number of threads.
pub fn estimate(
    image: &ScanImage,
    points: &[Vec3],
    origins: Option<&[Vec3]>,
    config: &NormalsConfig,
    out: &mut Vec<Normal>,
) {
    let cloud = Cloud {
        image,
        points,
        origins: origins.unwrap_or(&[]),
    };
    out.clear();
    out.resize(points.len(), Normal::default());
    let parts = out.par_chunks_mut(PART).enumerate();
    match config.estimator {
        Estimator::Adjacent => {
            let level = Level::new(); // the vector instructions of this CPU
            parts.for_each(|(part, out)| {
                dispatch!(level, _ => adjacent::normals(&cloud, part * PART, config.min_dot, out));
            });
        }
        Estimator::Holz => {
            let faces = holz::faces(&cloud);
            parts.for_each(|(part, out)| holz::normals(&cloud, &faces, part * PART, out));
        }
    }
}

/// Returns that one thread takes at a time.
const PART: usize = 2048;

/// An organized cloud.
struct Cloud<'a> {
    image: &'a ScanImage,
    points: &'a [Vec3],
    origins: &'a [Vec3],
}

impl Cloud<'_> {
    /// The return in a cell.
    #[inline(always)]
    fn at(&self, ring: usize, column: usize) -> Option<Vec3> {
        self.points.get(self.image.get(ring, column)?).copied()
    }

    /// From the sensor to a return.
    #[inline(always)]
    fn ray(&self, i: usize) -> Vec3 {
        self.points[i] - self.origins.get(i).copied().unwrap_or(Vec3::ZERO)
    }

    /// The columns on both sides of one.
    #[inline(always)]
    fn beside(&self, column: usize) -> (usize, usize) {
        let last = self.image.columns() - 1;
        (
            if column == 0 { last } else { column - 1 },
            if column == last { 0 } else { column + 1 },
        )
    }
}

/// Unit vectors whose sum is shorter than this cancel each other: it points nowhere.
const CANCELLED: f32 = 1e-3;
