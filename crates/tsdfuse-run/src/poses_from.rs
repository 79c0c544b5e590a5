//! Where the poses of scans come from.

use serde::{Deserialize, Serialize};

/// Where the poses of scans come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PosesFrom {
    /// From the log (or the pose file that is named); by odometry if there are none.
    #[default]
    Any,
    /// From the log (or the pose file that is named).
    Log,
    /// By odometry, whatever the log has.
    Track,
    /// From the log (or the pose file that is named), refined: each scan is registered to what the others saw.
    Refine,
}
