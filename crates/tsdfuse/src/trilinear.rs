//! Interpolation between the eight corners of a cell.

use std::ops::{Add, Mul};

use glam::Vec3;

/// Values at the corners of a cell; corner 1 lies at +x, 2 at +y, 4 at +z.
pub(crate) type Corners<T> = [T; 8];

/// The trilinear interpolation at a place in the cell, coordinates in 0..=1.
#[inline]
pub(crate) fn trilinear<T>(corners: &Corners<T>, at: Vec3) -> T
where
    T: Copy + Mul<f32, Output = T> + Add<Output = T>,
{
    let [a, b, c, d, e, f, g, h] = *corners;
    let low = mix(mix(a, b, at.x), mix(c, d, at.x), at.y);
    let high = mix(mix(e, f, at.x), mix(g, h, at.x), at.y);
    mix(low, high, at.z)
}

/// The gradient of [`trilinear`], per edge of the cell.
#[inline]
pub(crate) fn slope(corners: &Corners<f32>, at: Vec3) -> Vec3 {
    // Differences along one axis are bilinear between those on the four edges along it.
    let [a, b, c, d, e, f, g, h] = *corners;
    let between = |edges: [f32; 4], u: f32, w: f32| mix(mix(edges[0], edges[1], u), mix(edges[2], edges[3], u), w);
    Vec3::new(
        between([b - a, d - c, f - e, h - g], at.y, at.z),
        between([c - a, d - b, g - e, h - f], at.x, at.z),
        between([e - a, f - b, g - c, h - d], at.x, at.y),
    )
}

#[inline(always)]
fn mix<T: Copy + Mul<f32, Output = T> + Add<Output = T>>(a: T, b: T, s: f32) -> T {
    a * (1.0 - s) + b * s
}
