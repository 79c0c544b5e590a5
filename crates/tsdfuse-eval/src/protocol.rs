//! The rules of a comparison: presets of our own and of papers.

use serde::{Deserialize, Serialize};
use tsdfuse::glam::DVec3;

use crate::dense::DenseRule;
use crate::error::{EvalError, Result};

/// The rules by which a mesh is compared with a reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Protocol {
    /// The preset that it is based on.
    pub name: String,
    /// How the mesh is sampled.
    pub sampling: Sampling,
    /// The number of samples.
    pub samples: usize,
    /// The edge of the voxels in which samples and reference points are replaced by their means, metres.
    pub voxel_m: Option<f64>,
    /// What distances from the reference to the mesh are measured to.
    pub to_mesh: ToMesh,
    /// Whether triangles that reach beyond the reference's box (extended by `voxel_m` above and below) are left out.
    pub within_reference_box: bool,
    /// The box that is compared, `[min, max]`, metres. Nearest neighbours may lie outside it.
    pub crop: Option<[DVec3; 2]>,
    /// How long distances from the mesh to the reference count.
    pub accuracy_limit: Option<Limit>,
    /// How long distances from the reference to the mesh count.
    pub completeness_limit: Option<Limit>,
    /// The thresholds of precision, completeness and F-score, metres.
    pub thresholds_m: Vec<f64>,
    /// The rule of densely observed places.
    pub dense: DenseRule,
}

/// How a mesh is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// One point per equal share of the area: [`crate::sample::uniform`].
    Uniform,
    /// No two points near each other: [`crate::sample::poisson_disk`].
    PoissonDisk,
}

/// What distances from the reference to the mesh are measured to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToMesh {
    /// The nearest point of any triangle: exact.
    Surface,
    /// The nearest sample.
    Samples,
}

/// How long distances count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// Distances from this many metres on are left out, also from shares.
    LeaveOut(f64),
    /// Distances from this many metres on count as this many metres.
    Clamp(f64),
}

impl Limit {
    /// The distance from which the limit applies, metres.
    pub fn limit_m(self) -> f64 {
        match self {
            Self::LeaveOut(limit_m) | Self::Clamp(limit_m) => limit_m,
        }
    }
}

/// Fewer samples measure nothing; more, with their candidates, cannot be numbered with 32 bits.
const SAMPLES: std::ops::RangeInclusive<usize> = 100..=500_000_000;

impl Protocol {
    /// Our own protocol: a million points spread evenly over the area, exact distances in both directions, nothing left out.
    pub fn surface() -> Self {
        Self {
            name: "surface".to_owned(),
            sampling: Sampling::Uniform,
            samples: 1_000_000,
            voxel_m: None,
            to_mesh: ToMesh::Surface,
            within_reference_box: false,
            crop: None,
            accuracy_limit: None,
            completeness_limit: None,
            thresholds_m: vec![0.05, 0.10],
            dense: DenseRule::default(),
        }
    }

    /// The thesis's protocol (Miebach, Bonn 2021, 7.1.3 and 7.2): Poisson-disk samples of the mesh, the nearest point of all
    /// scans.
    pub fn thesis() -> Self {
        Self {
            name: "thesis".to_owned(),
            sampling: Sampling::PoissonDisk,
            ..Self::surface()
        }
    }

    /// The protocol of `eval_mesh` in SHINE-Mapping (Zhong et al., ICRA 2023), from which others are derived.
    fn shine(name: &str, voxel_m: f64, threshold_m: f64) -> Self {
        Self {
            name: name.to_owned(),
            samples: 10_000_000,
            voxel_m: Some(voxel_m),
            to_mesh: ToMesh::Samples,
            within_reference_box: true,
            accuracy_limit: Some(Limit::LeaveOut(2.0 * threshold_m)),
            completeness_limit: Some(Limit::Clamp(2.0)),
            thresholds_m: vec![threshold_m],
            ..Self::surface()
        }
    }

    /// The preset with a name from [`Protocol::NAMES`].
    pub fn by_name(name: &str) -> Option<Self> {
        Some(match name {
            "surface" => Self::surface(),
            "thesis" => Self::thesis(),
            // SHINE_mapping, eval/evaluator.py: "For NCD" and "For MaiCity".
            "shine" => Self::shine(name, 0.04, 0.2),
            "shine-maicity" => Self::shine(name, 0.01, 0.1),
            // N3-Mapping, eval/evaluator.py; its eval_utils.py leaves out what SHINE clamps.
            "n3" | "n3-maicity" => Self {
                completeness_limit: Some(Limit::LeaveOut(2.0)),
                ..Self::shine(name, 0.02, if name == "n3" { 0.2 } else { 0.1 })
            },
            // Splat-LOAM, the defaults of evaluate_recon in utils/eval_utils.py, which does not use the mesh it cropped.
            "splat-loam" => Self {
                within_reference_box: false,
                accuracy_limit: Some(Limit::LeaveOut(0.5)),
                completeness_limit: Some(Limit::Clamp(0.5)),
                ..Self::shine(name, 0.02, 0.2)
            },
            _ => return None,
        })
    }

    /// The names of all presets.
    pub const NAMES: [&str; 7] = [
        "surface",
        "thesis",
        "shine",
        "shine-maicity",
        "n3",
        "n3-maicity",
        "splat-loam",
    ];

    /// Checks all fields.
    ///
    /// # Errors
    /// [`EvalError::Protocol`] names the field and what is wrong.
    pub fn check(&self) -> Result<()> {
        let wrong = |field, wrong| Err(EvalError::Protocol { field, wrong });
        let positive = |value: f64| value > 0.0 && value.is_finite();
        if !SAMPLES.contains(&self.samples) {
            let wrong_count = format!("must be {} to {}, not {}", SAMPLES.start(), SAMPLES.end(), self.samples);
            return wrong("samples", wrong_count);
        }
        if let Some(voxel) = self.voxel_m.filter(|v| !(*v >= 1e-4 && v.is_finite())) {
            return wrong("voxel_m", format!("must be 0.0001 or more, not {voxel}"));
        }
        if let Some(threshold) = self.thresholds_m.iter().find(|t| !positive(**t)) {
            return wrong("thresholds_m", format!("must be more than 0, not {threshold}"));
        }
        let limits = [
            ("accuracy_limit", self.accuracy_limit),
            ("completeness_limit", self.completeness_limit),
        ];
        for (field, limit) in limits {
            if let Some(limit) = limit.map(Limit::limit_m)
                && !positive(limit)
            {
                return wrong(field, format!("must be more than 0, not {limit}"));
            }
        }
        if let Some([min, max]) = self.crop
            && !min.cmplt(max).all()
        {
            return wrong("crop", format!("has no volume: {min} to {max}"));
        }
        self.dense.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_a_sound_protocol_of_that_name() {
        for name in Protocol::NAMES {
            let protocol = Protocol::by_name(name).unwrap();
            protocol.check().unwrap();
            assert_eq!(protocol.name, name);
            let text = serde_json::to_string(&protocol).unwrap();
            assert_eq!(serde_json::from_str::<Protocol>(&text).unwrap(), protocol);
        }
        assert_eq!(Protocol::by_name("shone"), None);
    }

    #[test]
    fn wrong_fields_are_named() {
        let message = |change: fn(&mut Protocol)| {
            let mut protocol = Protocol::surface();
            change(&mut protocol);
            protocol.check().unwrap_err().to_string()
        };
        assert_eq!(message(|p| p.samples = 3), "samples must be 100 to 500000000, not 3");
        assert_eq!(
            message(|p| p.voxel_m = Some(0.0)),
            "voxel_m must be 0.0001 or more, not 0"
        );
        assert_eq!(
            message(|p| p.thresholds_m.push(-1.0)),
            "thresholds_m must be more than 0, not -1"
        );
        assert_eq!(
            message(|p| p.accuracy_limit = Some(Limit::Clamp(f64::NAN))),
            "accuracy_limit must be more than 0, not NaN"
        );
        assert_eq!(
            message(|p| p.crop = Some([DVec3::ZERO, DVec3::X])),
            "crop has no volume: [0, 0, 0] to [1, 0, 0]"
        );
        assert_eq!(
            message(|p| p.dense.cube_m = 0.0),
            "dense.cube_m must be 0.001 or more, not 0"
        );
    }
}
