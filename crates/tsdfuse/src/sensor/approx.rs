//! Angles from polynomials, so that every platform computes the same bits.
//!
//! The standard library's functions differ in the last bit between platforms; these use only `+ − × ÷ √`, which do not.
//! They are also faster, and compilers can vectorise the `f32` ones.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, SQRT_2};

/// `atan(t) = t·P(t²)` for `|t| ≤ tan(π/8)`: minimax polynomial, error below 1e-15.
const ATAN: [f64; 10] = [
    0.999999999999999,
    -0.33333333333221343,
    0.1999999997837687,
    -0.14285712660659053,
    0.11111048820585145,
    -0.09089529357362555,
    0.07673529098467827,
    -0.06505944155503311,
    0.050246342455960435,
    -0.02531472973194233,
];

/// `atan(t) = t·P(t²)` for `|t| ≤ 1`, error below 2e-8 (Abramowitz and Stegun 4.4.49).
const ATAN_F32: [f32; 9] = [
    1.0,
    -0.333_331_45,
    0.199_935_51,
    -0.142_089,
    0.106_562_64,
    -0.075_289_64,
    0.042_909_614,
    -0.016_165_737,
    0.002_866_225_7,
];

/// `acos(x) = √(1−x)·P(x)` for `0 ≤ x ≤ 1`, error below 2e-8 (Abramowitz and Stegun 4.4.46).
const ACOS_F32: [f32; 8] = [
    std::f32::consts::FRAC_PI_2,
    -0.214_598_8,
    0.088_978_99,
    -0.050_174_303,
    0.030_891_88,
    -0.017_088_126,
    0.006_670_09,
    -0.001_262_491_1,
];

/// Angle of the vector `(x, y)` from the x axis, radians in [−π, π], within 2e-15; 0 for the zero vector. Finite input.
pub fn atan2(y: f64, x: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let slope = ax.min(ay) / ax.max(ay).max(f64::MIN_POSITIVE);
    let (base, t) = if slope > SQRT_2 - 1.0 {
        // tan(π/8)
        (FRAC_PI_4, (slope - 1.0) / (slope + 1.0))
    } else {
        (0.0, slope)
    };
    let angle = base + t * ATAN.iter().rev().fold(0.0, |sum, c| sum * (t * t) + c);
    let angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    (if x < 0.0 { PI - angle } else { angle }).copysign(y)
}

/// [`atan2`] in `f32`, within 4e-7 radians.
#[inline(always)]
pub fn atan2_f32(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let t = ax.min(ay) / ax.max(ay).max(f32::MIN_POSITIVE);
    let angle = t * ATAN_F32.iter().rev().fold(0.0, |sum, c| sum * (t * t) + c);
    let angle = if ay > ax { FRAC_PI_2 as f32 - angle } else { angle };
    (if x < 0.0 { PI as f32 - angle } else { angle }).copysign(y)
}

/// Arc cosine of `x`, which is clamped to [−1, 1]; radians in [0, π], within 5e-7; NaN for NaN.
#[inline(always)]
pub fn acos_f32(x: f32) -> f32 {
    let ax = x.abs();
    let ax = if ax > 1.0 { 1.0 } else { ax };
    let angle = (1.0 - ax).sqrt() * ACOS_F32.iter().rev().fold(0.0, |sum, c| sum * ax + c);
    if x < 0.0 { PI as f32 - angle } else { angle }
}

/// Sine and cosine of an angle of at most a few turns, radians, within 1e-15.
pub fn sin_cos(angle: f64) -> (f64, f64) {
    let quarter = (angle / FRAC_PI_2).round();
    let r = angle - quarter * FRAC_PI_2;
    // Taylor: the remainder at |r| ≤ π/4 is below 1e-18.
    let series = |first: u32| {
        (0..9).rev().fold(0.0, |sum, i| {
            let k = f64::from(first + 2 * i);
            1.0 - r * r / ((k + 1.0) * (k + 2.0)) * sum
        })
    };
    let (sin, cos) = (r * series(1), series(0));
    match (quarter as i64).rem_euclid(4) {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angles that cover the circle, and those where polynomials meet.
    fn circle() -> impl Iterator<Item = f64> {
        let seams = (-16..=16).flat_map(|k| [-1e-9, 0.0, 1e-9].map(|e| f64::from(k) * PI / 16.0 + e));
        (-20_000..20_000).map(|i| f64::from(i) * 1.571e-4).chain(seams)
    }

    #[test]
    fn within_the_stated_error_of_the_standard_library() {
        for angle in circle() {
            let (s, c) = sin_cos(angle);
            assert!(
                (s - angle.sin()).abs() < 1e-15 && (c - angle.cos()).abs() < 1e-15,
                "{angle}"
            );
            let (y, x) = (3.7 * angle.sin(), 3.7 * angle.cos());
            assert!((atan2(y, x) - y.atan2(x)).abs() < 2e-15, "{angle}");
            let (y, x) = (y as f32, x as f32);
            let error = (f64::from(atan2_f32(y, x)) - f64::from(y).atan2(f64::from(x))).abs();
            assert!(error < 4e-7, "{angle}: {error}");
        }
        for i in -100_000..=100_000 {
            let x = i as f32 * 1e-5;
            let error = (f64::from(acos_f32(x)) - f64::from(x).acos()).abs();
            assert!(error < 5e-7, "{x}: {error}");
        }
    }

    #[test]
    fn corner_cases() {
        assert_eq!((atan2(0.0, 0.0), atan2_f32(0.0, 0.0)), (0.0, 0.0));
        assert_eq!((atan2(0.0, -1.0), atan2(-0.0, -1.0)), (PI, -PI));
        assert_eq!((acos_f32(1.000_001), acos_f32(-1.000_001)), (0.0, PI as f32));
        assert!(acos_f32(f32::NAN).is_nan());
    }
}
