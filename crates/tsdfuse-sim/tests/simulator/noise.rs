//! Each error of the sensor by itself.

use glam::{DVec3, Vec3};
use tsdfuse::sensor::model;
use tsdfuse_sim::{NoiseModel, Primitive, Scene, Simulator};

use super::{EXACT, distances, noisy, points, simulator};

fn mean_and_sigma(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
    (mean, variance.sqrt())
}

/// Range errors against the exact sensor, for effects that lose no return.
fn range_errors(noise: NoiseModel) -> Vec<f64> {
    let [exact, with_noise] = [NoiseModel::none(), noise].map(|n| points(&simulator("sphere", "os1-64", 12, noisy(n))));
    assert_eq!(exact.len(), with_noise.len());
    assert!(exact.len() > 20_000);
    let pairs = exact.iter().zip(&with_noise);
    pairs
        .map(|(a, b)| b.as_dvec3().length() - a.as_dvec3().length())
        .collect()
}

#[test]
fn range_noise_is_normal() {
    let errors = range_errors(NoiseModel {
        range_sigma_m: 0.02,
        ..NoiseModel::none()
    });
    let (mean, sigma) = mean_and_sigma(&errors);
    assert!(mean.abs() < 4.0 * 0.02 / (errors.len() as f64).sqrt(), "{mean}");
    assert!((sigma / 0.02 - 1.0).abs() < 0.03, "{sigma}");
    let share = |k: f64| errors.iter().filter(|e| e.abs() < k * 0.02).count() as f64 / errors.len() as f64;
    assert!((share(1.0) - 0.6827).abs() < 0.015 && (share(2.0) - 0.9545).abs() < 0.01);
}

#[test]
fn lasers_have_their_own_bias() {
    let noise = NoiseModel {
        laser_bias_sigma_m: 0.05,
        ..NoiseModel::none()
    };
    let errors = range_errors(noise);
    let rings = simulator("sphere", "os1-64", 12, EXACT)
        .scans()
        .flat_map(|s| s.rings.unwrap())
        .collect::<Vec<_>>();
    let of_ring = |ring: u16| -> Vec<f64> {
        let of = rings.iter().zip(&errors).filter(|(r, _)| **r == ring);
        of.map(|(_, e)| *e).collect()
    };
    let biases: Vec<f64> = (20..44)
        .map(|ring| {
            let (mean, sigma) = mean_and_sigma(&of_ring(ring));
            assert!(sigma < 1e-6, "ring {ring} varies by {sigma}");
            mean
        })
        .collect();
    let (_, sigma) = mean_and_sigma(&biases);
    assert!((0.025..0.08).contains(&sigma), "{sigma}");
}

#[test]
fn ranges_are_rounded_to_steps() {
    let noise = NoiseModel {
        range_step_m: 0.004,
        range_sigma_m: 0.02,
        ..NoiseModel::none()
    };
    for p in points(&simulator("sphere", "vlp16", 2, noisy(noise))) {
        let steps = p.as_dvec3().length() / 0.004;
        assert!((steps - steps.round()).abs() < 1e-3, "{steps}");
    }
}

/// What one effect loses is lost at random and leaves the other returns as they are.
#[test]
fn dropouts_leave_the_rest_alone() {
    let base = NoiseModel {
        range_sigma_m: 0.02,
        ..NoiseModel::none()
    };
    let all = points(&simulator("sphere", "os1-64", 6, noisy(base)));
    let left = points(&simulator(
        "sphere",
        "os1-64",
        6,
        noisy(NoiseModel { dropout: 0.1, ..base }),
    ));
    let share = left.len() as f64 / all.len() as f64;
    assert!((share - 0.9).abs() < 4.0 * (0.09 / all.len() as f64).sqrt(), "{share}");
    let mut rest = all.iter();
    assert!(
        left.iter().all(|p| rest.any(|q| p == q)),
        "a return that was not lost has changed"
    );
}

#[test]
fn weak_echoes_are_lost_far_away_and_at_grazing_incidence() {
    let lost = |name: &str, is_strong: &dyn Fn(&Vec3) -> bool| {
        let count = |weak_echo| {
            let noise = NoiseModel {
                weak_echo,
                ..NoiseModel::none()
            };
            points(&simulator(name, "hdl32e", 4, noisy(noise)))
                .iter()
                .filter(|p| is_strong(p))
                .count() as f64
        };
        1.0 - count(0.02) / count(0.0)
    };
    let near = lost("plane", &|p| p.length() < 10.0);
    let middle = lost("plane", &|p| (20.0..30.0).contains(&p.length()));
    let far = lost("plane", &|p| p.length() > 45.0);
    assert!(
        near < 0.01 && near < middle && middle < far && far > 0.02,
        "{near} {middle} {far}"
    );

    // Two walls equally far away: one across the beam, one almost along it.
    let wall = |x: f64, y: f64, yaw: f64| {
        Primitive::cuboid(DVec3::new(0.02, 60.0, 60.0))
            .turned(yaw)
            .at(x, y, 0.0)
    };
    let scene = Scene::new("walls", vec![wall(60.0, 0.0, 0.0), wall(-60.0, 0.0, 1.5)]);
    let count = |weak_echo: f64, side: f32| {
        let noise = NoiseModel {
            weak_echo,
            ..NoiseModel::none()
        };
        let path = vec![tsdfuse_sim::Pose::IDENTITY];
        let simulator = Simulator::new(scene.clone(), model("hdl32e").unwrap(), path, noisy(noise)).unwrap();
        points(&simulator).iter().filter(|p| p.x * side > 0.0).count() as f64
    };
    let [across, along] = [1.0, -1.0].map(|side| 1.0 - count(0.05, side) / count(0.0, side));
    assert!(
        across < 0.02 && along > 3.0 * across && along > 0.05,
        "{across} {along}"
    );
}

#[test]
fn wide_beams_leave_points_in_mid_air() {
    // A post 30 cm in front of a wall, its edges on the second columns from the middle.
    let post = Primitive::cuboid(DVec3::new(0.02, 0.236, 10.0)).at(9.7, 0.0, 0.0);
    let wall = Primitive::cuboid(DVec3::new(0.5, 40.0, 10.0)).at(10.25, 0.0, 0.0);
    let scene = Scene::new("post", vec![post, wall]);
    let in_mid_air = |divergence_rad| {
        let noise = NoiseModel {
            divergence_rad,
            ..NoiseModel::none()
        };
        let path = vec![tsdfuse_sim::Pose::IDENTITY];
        let simulator = Simulator::new(scene.clone(), model("os1-64").unwrap(), path, noisy(noise)).unwrap();
        let scan = simulator.nth_scan(0).unwrap();
        distances(&simulator, &scan, false)
            .iter()
            .filter(|d| d.abs() > 0.03)
            .count()
    };
    assert_eq!(in_mid_air(0.0), 0);
    let flying = in_mid_air(3e-3);
    // One on either edge of the post in each ring that meets both.
    assert!((20..400).contains(&flying), "{flying}");
}

#[test]
fn beam_directions_and_dust_add_errors() {
    let jitter = NoiseModel {
        angle_sigma_rad: 1e-3,
        ..NoiseModel::none()
    };
    let simulator_ = simulator("plane", "vlp16", 1, noisy(jitter));
    let scan = simulator_.nth_scan(0).unwrap();
    let (_, sigma) = mean_and_sigma(&distances(&simulator_, &scan, false));
    assert!((1e-3..2e-2).contains(&sigma), "{sigma}");

    let dust = NoiseModel {
        airborne: 0.05,
        ..NoiseModel::none()
    };
    let simulator_ = simulator("hall", "vlp16", 1, noisy(dust));
    let scan = simulator_.nth_scan(0).unwrap();
    let distances = distances(&simulator_, &scan, false);
    let floating = distances.iter().filter(|d| **d > 1e-3).count() as f64 / distances.len() as f64;
    assert!((0.03..0.07).contains(&floating), "{floating}");
    assert!(distances.iter().all(|d| *d > -1e-4), "dust lies before the surface");
}

#[test]
fn intensity_tells_material_and_incidence() {
    let scan = simulator("plane", "vlp16", 1, EXACT).nth_scan(0).unwrap();
    let [least, most] = [f32::min, f32::max].map(|f| scan.intensities.iter().flatten().copied().reduce(f).unwrap());
    assert!(
        least > 0.0 && least < 0.1 && most > 0.2 && most <= 0.4,
        "{least} {most}"
    );
}
