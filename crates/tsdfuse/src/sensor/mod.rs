//! Sensor models: beam tables, projections with exact inverses, and ring recovery.

pub mod approx;
mod correction;
mod cylindrical;
mod depth_image;
mod guess;
mod image;
mod order;
mod pinhole;
mod projection;
mod recovery;
mod rings;
mod sensor_model;
mod tables;
#[cfg(test)]
pub(crate) mod testing;
mod unorganized;

pub use correction::{BeamCorrection, CorrectionError, SensorCorrection};
pub use cylindrical::{CylindricalPoint, CylindricalProjection};
pub use depth_image::DepthImage;
pub use guess::guess;
pub(crate) use image::PART;
pub use image::{NONE, ScanImage};
#[doc(hidden)]
pub use image::{PHASE_BINS, SAME_FIRING, ring_gap_tangents};
pub use order::{OrderedRings, rings_by_order};
pub use pinhole::{MAX_IMAGE_EDGE, Pinhole, PinholeError};
pub use projection::{Pixel, Projection};
pub use recovery::recover_rings;
pub use rings::{NO_RING, RingRecovery, RingSource, sort_rings};
pub use sensor_model::{MAX_BEAMS, MAX_COLUMNS, SensorError, SensorModel};
pub use tables::{model, names};
pub(crate) use unorganized::{NEIGHBOUR_CELLS, grid_of};
