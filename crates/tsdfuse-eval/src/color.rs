//! Colours for distances.

/// The colour of a distance: [viridis](https://bids.github.io/colormap/) from dark blue at 0 to yellow at `max_m` and
/// beyond. sRGB.
pub fn of_distance(distance_m: f64, max_m: f64) -> [u8; 3] {
    let color = colorous::VIRIDIS.eval_continuous((distance_m / max_m).clamp(0.0, 1.0));
    [color.r, color.g, color.b]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_runs_from_blue_to_yellow_and_saturates() {
        assert_eq!(of_distance(0.0, 0.1), [68, 1, 84]);
        assert_eq!(of_distance(0.1, 0.1), [253, 231, 37]);
        assert_eq!(of_distance(f64::INFINITY, 0.1), of_distance(0.1, 0.1));
        let green = |d| of_distance(d, 0.1)[1];
        assert!((0..20).all(|i| green(f64::from(i) * 0.005) < green(f64::from(i + 1) * 0.005)));
    }
}
