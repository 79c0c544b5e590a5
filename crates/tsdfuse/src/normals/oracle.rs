//! The formulas written down literally in `f64`, and the comparison of the fast version with them.

use glam::DVec3;

use super::*;
use crate::sensor::testing::{random, scan_room};
use crate::sensor::{Pixel, Projection, SensorModel, model};
use proptest::prelude::*;
use std::f64::consts::PI;

/// What the formulas say of one return.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Truth {
    Nothing,
    Surface {
        normal: DVec3,
        agreement: f64,
    },
    /// A comparison came out so close that rounding decides it.
    Undecided,
}

struct Literal<'a> {
    model: &'a SensorModel,
    image: &'a ScanImage,
    points: &'a [Vec3],
    origins: &'a [Vec3],
}

impl Literal<'_> {
    fn p(&self, ring: i64, column: i64) -> Option<(DVec3, f64)> {
        let columns = i64::from(self.model.columns);
        let ring = usize::try_from(ring).ok()?;
        let i = self.image.get(ring, column.rem_euclid(columns) as usize)?;
        let p = self.points[i].as_dvec3();
        Some((p, p.distance(self.origins[i].as_dvec3())))
    }

    fn finish(&self, i: usize, sum: DVec3, used: &[DVec3]) -> Truth {
        let mut normal = sum.normalize(); // (5.13), (5.12)
        let angles: f64 = used.iter().map(|n| n.dot(normal).clamp(-1.0, 1.0).acos()).sum();
        let to_sensor = self.origins[i].as_dvec3() - self.points[i].as_dvec3();
        if normal.dot(to_sensor.normalize()).abs() < 1e-4 {
            return Truth::Undecided;
        }
        if normal.dot(to_sensor) < 0.0 {
            normal = -normal; // [E4]
        }
        Truth::Surface {
            normal,
            agreement: (1.0 - angles / PI).max(0.0), // (5.17)
        }
    }

    fn adjacent(&self, i: usize, threshold: f64) -> Truth {
        let Some((u, v)) = self.image.place_of(i).map(|(u, v)| (u as i64, v as i64)) else {
            return Truth::Nothing;
        };
        let p = self.points[i].as_dvec3();
        let neighbours = [self.p(u - 1, v), self.p(u, v + 1), self.p(u + 1, v), self.p(u, v - 1)];
        let Some(neighbours) = neighbours.into_iter().collect::<Option<Vec<_>>>() else {
            return Truth::Nothing;
        };
        let n: Vec<DVec3> = (0..4)
            .map(|j| (neighbours[j].0 - p).cross(neighbours[(j + 1) % 4].0 - p).normalize())
            .collect();
        let dot = |i: usize, j: usize| if i == j { -1.0 } else { n[i].dot(n[j]) };
        if (0..4).any(|i| (0..4).any(|j| (dot(i, j) - threshold).abs() < 1e-3)) {
            return Truth::Undecided;
        }
        let used: Vec<DVec3> = (0..4)
            .filter(|&i| (0..4).any(|j| dot(i, j) > threshold))
            .map(|i| n[i])
            .collect();
        let sum: DVec3 = used.iter().sum();
        match sum.length() {
            _ if used.is_empty() => Truth::Nothing,
            short if short < 0.1 => Truth::Undecided,
            _ => self.finish(i, sum, &used),
        }
    }

    fn holz(&self, i: usize) -> Truth {
        let Some((u, v)) = self.image.place_of(i).map(|(u, v)| (u as i64, v as i64)) else {
            return Truth::Nothing;
        };
        let (mut faces, mut undecided) = (Vec::new(), false);
        for (du, dv) in [(0, 0), (0, -1), (-1, 0), (-1, -1)] {
            let quad = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(a, b)| self.p(u + du + a, v + dv + b));
            let [Some(a), Some(b), Some(c), Some(d)] = quad else {
                continue;
            };
            let elevation = |ring: i64| f64::from(self.model.elevations_deg[ring as usize]).to_radians();
            let between = (elevation(u + du + 1) - elevation(u + du)).tan();
            let within = self.model.column_width_rad().tan();
            let mut valid = true;
            for ((p, d_p), (q, d_q), tangent) in [(a, b, within), (c, d, within), (a, c, between), (b, d, between)] {
                let ratio = p.distance(q) / (2f64.sqrt() * d_p.min(d_q) * tangent); // (5.11)
                valid &= ratio <= 1.0;
                undecided |= (ratio - 1.0).abs() < 1e-4;
            }
            if valid {
                faces.push((b.0 - a.0).cross(c.0 - a.0));
            }
        }
        let used: Vec<DVec3> = faces.iter().map(|f| f.normalize()).collect();
        match faces.iter().sum::<DVec3>() {
            _ if undecided => Truth::Undecided,
            _ if faces.is_empty() => Truth::Nothing,
            sum => self.finish(i, sum, &used),
        }
    }
}

/// Compares every return both ways; how many were decided, or the first that differs.
fn compare(fast: &[Normal], truth: &[Truth]) -> Result<usize, String> {
    assert_eq!(fast.len(), truth.len());
    let mut decided = 0;
    for (i, (fast, truth)) in fast.iter().zip(truth).enumerate() {
        let same = match *truth {
            Truth::Undecided => continue,
            Truth::Nothing => !fast.is_some() && fast.agreement == 0.0,
            Truth::Surface { normal, agreement } => {
                fast.normal.as_dvec3().distance(normal) < 1e-3 && (f64::from(fast.agreement) - agreement).abs() < 2e-3
            }
        };
        if !same {
            return Err(format!("return {i}: {fast:?} against {truth:?}"));
        }
        decided += 1;
    }
    Ok(decided)
}

/// A rough surface with steps and holes, seen by a moving sensor: image, deskewed points and origins.
struct Rough {
    model: SensorModel,
    image: ScanImage,
    points: Vec<Vec3>,
    origins: Vec<Vec3>,
}

fn rough(seed: usize, columns: u32, roughness: f64, holes: f32) -> Rough {
    let elevations = (0..9).map(|i| -8.0 + 2.0 * i as f32 + random(seed + i)).collect();
    let model = SensorModel::from_beams("rough", elevations, columns, (0.1, 99.0)).unwrap();
    let projection = Projection::new(&model);
    let (mut measured, mut rings, mut points, mut origins) = (vec![], vec![], vec![], vec![]);
    for (i, (column, ring)) in (0..columns).flat_map(|c| (0..9u16).map(move |r| (c, r))).enumerate() {
        let noise = |k: usize| f64::from(random(seed.wrapping_mul(7919) + 5 * i + k));
        if noise(0) < f64::from(holes) {
            continue;
        }
        let pixel = Pixel {
            row: f64::from(ring),
            column: f64::from(column),
        };
        let step = if noise(1) < 0.1 { 3.0 } else { 0.0 };
        let point = projection.direction(pixel) * (5.0 + roughness * noise(2) + step);
        let origin = DVec3::new(0.01, -0.02, 0.005) * f64::from(column);
        measured.push(point.as_vec3());
        rings.push(ring);
        points.push((point + origin).as_vec3());
        origins.push(origin.as_vec3());
    }
    let mut image = ScanImage::new();
    image.update(&measured, &rings, &model);
    Rough {
        model,
        image,
        points,
        origins,
    }
}

impl Rough {
    fn fast(&self, estimator: Estimator) -> Vec<Normal> {
        let config = NormalsConfig {
            estimator,
            ..Default::default()
        };
        let mut out = Vec::new();
        estimate(&self.image, &self.points, Some(&self.origins), &config, &mut out);
        out
    }

    fn truth(&self, estimator: Estimator) -> Vec<Truth> {
        let literal = Literal {
            model: &self.model,
            image: &self.image,
            points: &self.points,
            origins: &self.origins,
        };
        let of = |i| match estimator {
            Estimator::Adjacent => literal.adjacent(i, 0.8),
            Estimator::Holz => literal.holz(i),
        };
        (0..self.points.len()).map(of).collect()
    }
}

const BOTH: [Estimator; 2] = [Estimator::Adjacent, Estimator::Holz];

proptest! {
    #[test]
    fn both_estimators_do_what_the_formulas_say(seed in 0..1_000_000usize, columns in 3..80u32, roughness in 0.0..1.0f64, holes in 0.0..0.3f32) {
        let scan = rough(seed, columns, roughness, holes);
        for estimator in BOTH {
            let compared = compare(&scan.fast(estimator), &scan.truth(estimator));
            prop_assert!(compared.is_ok(), "{estimator:?}: {compared:?}");
        }
    }
}

#[test]
fn nearly_all_is_decided_and_both_kinds_of_outcome_occur() {
    let scan = rough(1, 200, 0.2, 0.05);
    for estimator in BOTH {
        let decided = compare(&scan.fast(estimator), &scan.truth(estimator)).unwrap();
        let found = scan.fast(estimator).iter().filter(|n| n.is_some()).count();
        assert!(
            decided * 100 > 97 * scan.points.len(),
            "{estimator:?}: {decided} of {}",
            scan.points.len()
        );
        assert!(found > 500 && found < scan.points.len() - 200, "{estimator:?}: {found}");
    }
}

#[test]
fn the_comparison_notices_every_kind_of_disturbance() {
    let scan = rough(2, 100, 0.2, 0.05);
    for estimator in BOTH {
        let (fast, truth) = (scan.fast(estimator), scan.truth(estimator));
        let decided = |surface: bool| {
            let wanted = |t: &Truth| matches!(t, Truth::Surface { .. }) == surface && *t != Truth::Undecided;
            truth.iter().position(wanted).unwrap()
        };
        let disturbed = |i: usize, change: fn(&mut Normal)| {
            let mut fast = fast.clone();
            change(&mut fast[i]);
            compare(&fast, &truth)
        };
        assert!(compare(&fast, &truth).is_ok());
        let i = decided(true);
        assert!(
            disturbed(i, |n| n.normal =
                (n.normal + Vec3::new(0.003, -0.002, 0.001)).normalize())
            .is_err()
        );
        assert!(disturbed(i, |n| n.normal = -n.normal).is_err());
        assert!(disturbed(i, |n| n.agreement += 0.01).is_err());
        assert!(disturbed(i, |n| *n = Normal::default()).is_err());
        assert!(disturbed(decided(false), |n| n.normal = Vec3::Z).is_err());
    }
}

fn normals(model: &SensorModel, points: &[Vec3], rings: &[u16], estimator: Estimator) -> (ScanImage, Vec<Normal>) {
    let mut image = ScanImage::new();
    image.update(points, rings, model);
    let config = NormalsConfig {
        estimator,
        ..Default::default()
    };
    let mut out = Vec::new();
    estimate(&image, points, None, &config, &mut out);
    (image, out)
}

#[test]
fn walls_have_their_normals_also_around_column_0_and_edges_do_not_blend() {
    let model = model("os0-128").unwrap();
    let (points, rings) = scan_room(&model, |_| 0.0);
    for estimator in BOTH {
        let (image, out) = normals(&model, &points, &rings, estimator);
        let inward = |p: Vec3| -> Vec3 {
            let walls = [Vec3::X * 12.0, Vec3::Y * 7.0, Vec3::Z * 2.5];
            let nearest = walls
                .into_iter()
                .min_by(|a, b| wall_gap(p, *a).total_cmp(&wall_gap(p, *b)));
            let axis = nearest.unwrap().normalize();
            -axis * p.dot(axis).signum()
        };
        let found: Vec<usize> = (0..points.len()).filter(|&i| out[i].is_some()).collect();
        let right = found
            .iter()
            .filter(|&&i| out[i].normal.dot(inward(points[i])) > 0.9999)
            .count();
        assert!(
            right as f32 > 0.9 * found.len() as f32,
            "{estimator:?}: {right} of {}",
            found.len()
        );
        // The middle of the wall ahead lies around column 0.
        for column in [1023, 0, 1] {
            let i = image.get(64, column).unwrap();
            assert!(
                out[i].normal.distance(-Vec3::X) < 1e-3 && out[i].agreement > 0.99,
                "{estimator:?}: {:?}",
                out[i]
            );
        }
        // Rows do not wrap: the lowest ring has no neighbours below.
        if estimator == Estimator::Adjacent {
            assert!((0..1024).all(|c| !out[image.get(0, c).unwrap()].is_some()));
        }
    }
}

/// How far a point in the room is from the pair of walls at ±`wall`.
fn wall_gap(p: Vec3, wall: Vec3) -> f32 {
    (p.dot(wall.normalize()).abs() - wall.length()).abs()
}

#[test]
fn the_floor_under_a_sensor_faces_it_in_every_pose() {
    // Down to nearly the nadir: Holz's mesh ends where a floor is seen under less than 45°.
    let beams = (0..130).map(|i| -88.0 + 0.5 * i as f32).collect();
    let model = SensorModel::from_beams("steep", beams, 512, (0.01, 9.0)).unwrap();
    let projection = Projection::new(&model);
    let (mut points, mut rings) = (vec![], vec![]);
    // A drone standing on the floor, 12 cm below the sensor.
    for (column, ring) in (0..model.columns).flat_map(|c| (0..130u16).map(move |r| (c, r))) {
        let d = projection.direction(Pixel {
            row: f64::from(ring),
            column: f64::from(column),
        });
        points.push((d * (-0.12 / d.z)).as_vec3());
        rings.push(ring);
    }
    let mut image = ScanImage::new();
    image.update(&points, &rings, &model);
    for turn in 0..20 {
        let angles = [0, 1, 2].map(|k| 6.3 * random(3 * turn + k));
        let rotation = glam::Quat::from_euler(glam::EulerRot::ZYX, angles[0], angles[1], angles[2]);
        let posed: Vec<Vec3> = points.iter().map(|&p| rotation * p).collect();
        for estimator in BOTH {
            let config = NormalsConfig {
                estimator,
                ..Default::default()
            };
            let mut out = Vec::new();
            estimate(&image, &posed, None, &config, &mut out);
            let found = out.iter().filter(|n| n.is_some()).count();
            assert!(found > 30_000, "{estimator:?}: {found}");
            assert!(
                out.iter()
                    .filter(|n| n.is_some())
                    .all(|n| n.normal.dot(rotation * Vec3::Z) > 0.999)
            );
        }
    }
}

#[test]
fn the_origin_of_each_ray_decides_the_side() {
    let scan = rough(3, 60, 0.0, 0.0);
    // Seen from far outside, the same surface faces outwards.
    let outside: Vec<Vec3> = scan.points.iter().map(|p| *p * 9.0).collect();
    let (mut inner, mut outer) = (Vec::new(), Vec::new());
    let config = NormalsConfig::default();
    estimate(&scan.image, &scan.points, None, &config, &mut inner);
    estimate(&scan.image, &scan.points, Some(&outside), &config, &mut outer);
    assert!(inner.iter().filter(|n| n.is_some()).count() > 200);
    assert!(inner.iter().zip(&outer).all(|(a, b)| a.normal == -b.normal));
}

#[test]
fn lonely_and_missing_returns_have_no_normal() {
    let model = model("vlp16").unwrap();
    for estimator in BOTH {
        let (_, out) = normals(&model, &[Vec3::X, Vec3::NAN, Vec3::ZERO], &[8, 8, 9], estimator);
        assert_eq!(out, [Normal::default(); 3]);
        let (_, out) = normals(&model, &[], &[], estimator);
        assert!(out.is_empty());
    }
    // An image of other points is no reason to panic.
    let (image, _) = normals(
        &model,
        &scan_room(&model, |_| 0.0).0,
        &scan_room(&model, |_| 0.0).1,
        Estimator::Holz,
    );
    let mut out = Vec::new();
    for config in BOTH.map(|estimator| NormalsConfig {
        estimator,
        ..Default::default()
    }) {
        estimate(&image, &[Vec3::X; 40], None, &config, &mut out);
        assert_eq!(out.len(), 40);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let model = model("pandar64").unwrap();
    let (points, rings) = scan_room(&model, |ring| f64::from(random(ring)));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| BOTH.map(|estimator| normals(&model, &points, &rings, estimator).1))
    };
    assert!(on(1) == on(2) && on(1) == on(7));
}

#[test]
fn configurations_are_checked() {
    assert!(NormalsConfig::default().validate().is_ok());
    for min_dot in [1.0, -1.5, f32::NAN] {
        let config = NormalsConfig {
            min_dot,
            ..Default::default()
        };
        assert!(config.validate().unwrap_err().to_string().contains("min_dot"));
    }
}
