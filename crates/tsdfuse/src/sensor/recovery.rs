//! Ring recovery by elevation or by order, whichever explains a cloud better.

use glam::Vec3;

use super::SensorModel;
use super::order::rings_by_order;
use super::rings::{Beams, CLEAR, RingRecovery};

/// Finds the ring of every point (sensor frame, metres) among the beams of a known sensor.
pub fn recover_rings(points: &[Vec3], model: &SensorModel) -> RingRecovery {
    let by_elevation = Beams::new(model).recover(points);
    if by_elevation.within_tolerance >= CLEAR {
        return by_elevation;
    }
    let by_order = rings_by_order(points).and_then(|o| o.named_after(model));
    match by_order {
        Some(by_order) if by_order.within_tolerance > by_elevation.within_tolerance => by_order,
        _ => by_elevation,
    }
}
