//! What can be wrong with a configuration.

/// A configuration that makes no sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} = {value}: {wanted}")]
pub struct PlanError {
    /// The option.
    pub name: &'static str,
    /// What it was set to.
    pub value: f64,
    /// What is possible.
    pub wanted: String,
}

impl PlanError {
    pub(crate) fn new(name: &'static str, value: f64, wanted: impl Into<String>) -> Self {
        let wanted = wanted.into();
        Self { name, value, wanted }
    }
}

/// Refuses voxels of an impossible size.
pub(crate) fn check_voxel_size(voxel_size_m: f64) -> Result<(), PlanError> {
    // Also false for NaN.
    let is_possible = voxel_size_m > 1e-3 && voxel_size_m < 1e3;
    let wrong = || PlanError::new("voxel_size_m", voxel_size_m, "1 mm to 1 km");
    is_possible.then_some(()).ok_or_else(wrong)
}

/// Refuses voxels of an impossible size, and rays through too many of them.
pub(crate) fn check_rays(voxel_size_m: f64, max_range_m: f64) -> Result<(), PlanError> {
    check_voxel_size(voxel_size_m)?;
    let is_possible = max_range_m > 0.0 && max_range_m / voxel_size_m < 1e5;
    let wanted = "more than 0, and less than 100,000 voxels";
    is_possible
        .then_some(())
        .ok_or_else(|| PlanError::new("max_range_m", max_range_m, wanted))
}
