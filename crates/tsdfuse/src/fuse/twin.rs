//! What a second implementation takes from this one, most of it of [`Patch`](super::Patch), so that whatever is tuned here is tuned there.

pub use super::agreement::{
    ARMS, BINS_PER_VOXEL, BLUR, HALVING, LEAST_OFFSETS, LOOK, OF_MEDIAN, OTHER_STEPS, OWN_STEPS, SIGMAS, SIGMAS_OF_RAYS,
};
pub use super::carve::{BESIDE, BINS_PER_RAD, FORGOTTEN, INSIDE, LEFT, MARGIN, MIN_PASSED, TURNS, nearest_rings};
pub use super::cylindrical::cylindrical_image;
pub use super::patch::{BEHIND, FRONT, FULL_BEHIND, STEP, crowd};
pub use super::settled::{AGREES, KNOWN, LEAST_LINES, MOST_TIMES, OTHER_SURFACE};
pub use crate::patch::{
    COPLANAR_DOT, COPLANAR_GAPS, COPLANAR_LENGTH_M, COPLANAR_OFF_M, FACING, FAR_M, MAX_COLUMNS, MAX_GAP_ACROSS_M,
    MAX_GAP_OF_RANGE, MAX_OFF, MAX_OFF_BETWEEN, MAX_RESIDUAL, MAX_RINGS, MIN_COSINE, MIN_DOT, MIN_RETURNS, MIN_SPREAD,
    MIN_TELLING, NOISE_M, RAY_WEIGHT, ROUGHNESS_M, SAMPLE, widest_gap_m,
};
pub use crate::sensor::{PHASE_BINS, SAME_FIRING, ring_gap_tangents};
