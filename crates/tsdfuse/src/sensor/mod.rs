//! Sensor models: beam tables, projections with exact inverses, and ring recovery.

use serde::{Deserialize, Serialize};

/// A rotating LiDAR: its beams, how finely it samples a turn, and which ranges it measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Lower-case name as on the command line, for instance `pandar64`.
    pub name: String,
    /// Elevation of each beam above the sensor's horizontal plane, degrees, ascending: ring 0 is the lowest.
    pub elevations_deg: Vec<f32>,
    /// Firings in one turn.
    pub columns: u32,
    /// Shortest measurable range.
    pub min_range_m: f32,
    /// Longest measurable range (χ in the weights of the methods).
    pub max_range_m: f32,
}
