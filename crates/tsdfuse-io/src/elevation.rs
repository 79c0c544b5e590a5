//! A known error of a sensor's elevations, taken back.

use tsdfuse::glam::Vec3;

/// The points of KITTI's HDL-64E lie this much too low, degrees (Deschaud, IMLS-SLAM, ICRA 2018, section IV-B).
pub(crate) const KITTI_HDL64E_DEG: f64 = 0.205;

/// A larger error is none of a sensor's, degrees.
pub(crate) const MAX_DEG: f64 = 5.0;

/// Whether elevations can be off by this.
pub(crate) fn is_possible(degrees: f64) -> bool {
    degrees.abs() <= MAX_DEG
}

/// Turns each point up by an angle about the horizontal axis across its azimuth.
/// Ranges and azimuths stay; points above or below the sensor stay where they are.
pub(crate) fn turn_up(points: &mut [Vec3], degrees: f64) {
    let (sin, cos) = degrees.to_radians().sin_cos();
    for point in points {
        let across = f64::from(point.x).hypot(f64::from(point.y));
        if across > 0.0 {
            let z = f64::from(point.z);
            let scale = cos - z / across * sin;
            *point = Vec3::new(
                (f64::from(point.x) * scale) as f32,
                (f64::from(point.y) * scale) as f32,
                (z * cos + across * sin) as f32,
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elevations_rise_and_all_else_stays() {
        let mut points: Vec<Vec3> = (0..200)
            .map(|i| {
                let (azimuth, elevation) = (0.3 * i as f32, (i as f32 * 0.37).sin() * 1.2);
                let (sin, cos) = elevation.sin_cos();
                Vec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin) * (1.0 + i as f32)
            })
            .collect();
        let before = points.clone();
        turn_up(&mut points, 0.205);
        for (a, b) in before.iter().zip(&points) {
            let elevation = |p: &Vec3| f64::from(p.z).atan2(f64::from(p.x).hypot(f64::from(p.y))).to_degrees();
            assert!((elevation(b) - elevation(a) - 0.205).abs() < 1e-4, "{a} {b}");
            assert!((a.length() - b.length()).abs() < 1e-4 && (a.y.atan2(a.x) - b.y.atan2(b.x)).abs() < 1e-5);
        }
        let odd = [Vec3::ZERO, Vec3::Z, Vec3::NAN];
        let mut turned = odd;
        turn_up(&mut turned, 0.205);
        assert_eq!(turned[..2], odd[..2]);
        assert!(turned[2].is_nan());
    }
}
