//! Trees and hedges.

use glam::{DQuat, DVec3};
use rand::RngExt;
use tsdfuse::Pose;

use super::parts::{FOOTING_M, Parts, Rng};
use crate::primitive::Primitive;

const BARK: f64 = 0.25;
const LEAVES: f64 = 0.45;

/// A broad-leaved street tree, 5 to 7 m high: a leaning trunk, branches, and a crown of overlapping ellipsoids.
pub(crate) fn tree(rng: &mut Rng) -> Parts {
    let mut tree = Parts::of(BARK);
    let fork = DVec3::new(
        rng.random_range(-0.15..0.15),
        rng.random_range(-0.15..0.15),
        rng.random_range(2.3..2.9),
    );
    let radius = rng.random_range(0.12..0.2);
    tree.cone([0.0, 0.0, -FOOTING_M], fork.into(), 1.15 * radius, 0.75 * radius);
    tree.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.25], 1.7 * radius, 1.05 * radius);
    tree.ball(fork.into(), [0.8 * radius; 3]);
    let branches = rng.random_range(4..7_u32);
    let crown = fork + DVec3::Z * rng.random_range(1.4..1.9);
    let phase = rng.random_range(0.0..6.3);
    for i in 0..branches {
        let angle = phase + std::f64::consts::TAU * f64::from(i) / f64::from(branches);
        let reach = rng.random_range(0.7..1.1);
        let tip = fork + DVec3::new(reach * angle.cos(), reach * angle.sin(), rng.random_range(0.8..1.3));
        tree.material(BARK);
        tree.cone(fork.into(), tip.into(), 0.45 * radius, 0.2 * radius);
        tree.material(LEAVES);
        leaves(&mut tree, rng, tip, 0.55..0.8);
    }
    tree.material(BARK);
    tree.cone(fork.into(), crown.into(), 0.6 * radius, 0.25 * radius);
    tree.material(LEAVES);
    leaves(&mut tree, rng, crown, 0.9..1.2);
    for _ in 0..4 {
        let aside = DVec3::new(
            rng.random_range(-0.7..0.7),
            rng.random_range(-0.7..0.7),
            rng.random_range(0.1..0.9),
        );
        leaves(&mut tree, rng, crown + aside, 0.5..0.8);
    }
    tree
}

fn leaves(tree: &mut Parts, rng: &mut Rng, at: DVec3, size: std::ops::Range<f64>) {
    let r = rng.random_range(size);
    let axes = DVec3::new(r, r * rng.random_range(0.8..1.0), r * rng.random_range(0.65..0.85));
    let rotation =
        DQuat::from_rotation_z(rng.random_range(0.0..3.1)) * DQuat::from_rotation_x(rng.random_range(-0.3..0.3));
    let pose = Pose {
        rotation,
        translation: at,
    };
    tree.add(Primitive::ellipsoid(axes).placed(&pose));
}

/// A conifer of stacked cones, 3.5 to 5 m high.
pub(crate) fn conifer(rng: &mut Rng) -> Parts {
    let mut tree = Parts::of(BARK);
    let height = rng.random_range(3.5..5.0);
    tree.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.9 * height], 0.13, 0.03);
    tree.material(LEAVES);
    let tiers = rng.random_range(4..6_u32);
    for i in 0..tiers {
        let s = f64::from(i) / f64::from(tiers);
        let foot = 0.5 + (height - 0.7) * s;
        let radius = 1.15 * (1.0 - 0.75 * s);
        tree.cone(
            [0.0, 0.0, foot],
            [0.0, 0.0, foot + 1.15 * height / f64::from(tiers)],
            radius,
            0.06,
        );
    }
    tree
}

/// A clipped hedge along x from 0, with an uneven top and face.
pub(crate) fn hedge(rng: &mut Rng, length: f64) -> Parts {
    let mut hedge = Parts::of(LEAVES);
    hedge.block([0.0, -0.28, -0.4], [length, 0.28, 0.95]);
    let bumps = (length / 0.45) as u32;
    for i in 0..bumps {
        let x = 0.25 + (length - 0.5) * f64::from(i) / f64::from(bumps.max(2) - 1);
        let [dy, dz] = [0.0, 0.0].map(|_: f64| rng.random_range(-0.05..0.05));
        hedge.ball(
            [x, dy, 0.55 + dz],
            [rng.random_range(0.2..0.3), 0.33, rng.random_range(0.4..0.5)],
        );
    }
    hedge
}
