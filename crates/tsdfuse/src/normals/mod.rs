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
mod cloud;
mod holz;
#[cfg(test)]
mod oracle;

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use cloud::Normal;

use crate::sensor::ScanImage;
use cloud::Cloud;

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
