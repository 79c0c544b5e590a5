//! Returns as they are registered, and how much each of them counts.

use glam::Vec3;

/// Returns that one thread sums up at a time. The sums are added in order, so threads change no bit.
pub(crate) const GRAIN: usize = 512;

/// The kernel's width where the motion has converged, in standard deviations.
pub(crate) const KERNEL: f64 = 2.5;

/// A return to register: in the sensor frame, at a share of the sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Return {
    pub(crate) point: Vec3,
    pub(crate) share: f32,
    /// Of its beam, if that is known.
    pub(crate) ring: Option<u16>,
}

/// The weight of a residual, after Geman and McClure; `scale` is the square of the kernel's width.
pub(crate) fn kernel(r: f64, scale: f64) -> f64 {
    (scale / (scale + r * r)).powi(2)
}
