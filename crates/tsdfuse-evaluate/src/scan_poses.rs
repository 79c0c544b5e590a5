//! Whose poses scans are fused with: those that are given, refined or tracked ones.

use serde::Serialize;
use tsdfuse_run::PosesFrom;

/// Whose poses scans are fused with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ScanPoses {
    /// The log's, or those of the file that is named.
    #[default]
    Given,
    /// The given ones, refined: each scan is registered to what the others saw.
    Refine,
    /// Those of odometry, moved to the given ones as a whole.
    Track,
}

impl ScanPoses {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Given, Self::Refine, Self::Track];

    /// How a run is told of them.
    pub fn from(self) -> PosesFrom {
        match self {
            Self::Given => PosesFrom::Any,
            Self::Refine => PosesFrom::Refine,
            Self::Track => PosesFrom::Track,
        }
    }

    /// The word for them.
    pub fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Refine => "refine",
            Self::Track => "track",
        }
    }
}
