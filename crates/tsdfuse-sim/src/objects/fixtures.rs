//! What a hall is fitted with.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use tsdfuse::Pose;

use super::parts::{Parts, SUNK_M};

const STEEL: f64 = 0.35;
const CONCRETE: f64 = 0.3;

/// A pillar from the floor to `height`: round or square, with base and capital.
pub(crate) fn pillar(round: bool, height: f64) -> Parts {
    let mut pillar = Parts::of(CONCRETE);
    let (foot, head) = (-SUNK_M, height + SUNK_M);
    if round {
        pillar.tube([0.0, 0.0, foot], [0.0, 0.0, head], 0.24);
        pillar.cone([0.0, 0.0, foot], [0.0, 0.0, 0.22], 0.42, 0.3);
        pillar.cone([0.0, 0.0, height - 0.45], [0.0, 0.0, height - 0.1], 0.24, 0.45);
        pillar.tube([0.0, 0.0, height - 0.1], [0.0, 0.0, head], 0.45);
    } else {
        pillar.block([-0.23, -0.23, foot], [0.23, 0.23, head]);
        pillar.block([-0.36, -0.36, foot], [0.36, 0.36, 0.2]);
        pillar.block([-0.4, -0.4, height - 0.3], [0.4, 0.4, head]);
        // A guard against forklifts.
        pillar.material(0.7);
        pillar.block([-0.26, -0.26, 0.4], [0.26, 0.26, 1.1]);
    }
    pillar
}

/// A steel I-beam along y, its upper face at z = 0.
pub(crate) fn i_beam(y: [f64; 2], height: f64, flange: f64) -> Parts {
    let mut beam = Parts::of(STEEL);
    let (t, w, f) = (0.035, 0.02, flange / 2.0);
    let outline = [
        [-f, -height],
        [f, -height],
        [f, -height + t],
        [w, -height + t],
        [w, -t],
        [f, -t],
        [f, 0.0],
        [-f, 0.0],
        [-f, -t],
        [-w, -t],
        [-w, -height + t],
        [-f, -height + t],
    ];
    beam.profile(&outline, y);
    beam
}

/// A lamp that hangs `drop` below z = 0.
pub(crate) fn hanging_lamp(drop: f64) -> Parts {
    let mut lamp = Parts::of(STEEL);
    lamp.tube([0.0, 0.0, -drop], [0.0, 0.0, 0.02], 0.012);
    lamp.cone([0.0, 0.0, -drop - 0.18], [0.0, 0.0, -drop + 0.05], 0.28, 0.06);
    lamp.material(0.8);
    lamp.ball([0.0, 0.0, -drop - 0.17], [0.12, 0.12, 0.14]);
    lamp
}

/// Stairs along +x from x = 0 with open treads on two stringers, up to a platform; 1.5 m wide from y = −1.5 to 0.
pub(crate) fn mezzanine(height: f64, length: f64) -> Parts {
    let mut stairs = Parts::of(STEEL);
    let count = (height / 0.18).round();
    let (rise, going) = (height / count, 0.27);
    let end = going * (count - 1.0);
    for i in 1..count as u32 {
        let (x, z) = (going * f64::from(i - 1), rise * f64::from(i));
        stairs.block([x, -1.42, z - 0.04], [x + 0.29, -0.08, z]);
    }
    // Stringers.
    let below = 0.32;
    for y in [[-1.46, -1.4], [-0.1, -0.04]] {
        stairs.profile(
            &[
                [-0.05, -SUNK_M],
                [0.42, -SUNK_M],
                [end + 0.3, height - below],
                [end + 0.3, height],
                [end, height],
                [-0.05, rise],
            ],
            y,
        );
    }
    let far = end + 0.25 + length;
    stairs.block([end + 0.25, -2.6, height - 0.16], [far, 0.0, height]);
    stairs.railing([0.1, -1.43, rise], [end + 0.1, -1.43, height], 0.95, 1.0);
    stairs.railing([end + 0.3, -2.55, height], [far - 0.05, -2.55, height], 1.05, 0.14);
    stairs.railing([far - 0.05, -2.55, height], [far - 0.05, -0.05, height], 1.05, 0.14);
    stairs.railing([end + 0.3, -2.55, height], [end + 0.3, -1.5, height], 1.05, 0.14);
    for (x, y) in [(end + 0.4, -2.5), (far - 0.15, -2.5), (far - 0.15, -0.15)] {
        stairs.tube([x, y, -SUNK_M], [x, y, height - 0.1], 0.06);
    }
    stairs
}

/// A ladder along z, `length` long, rungs along y.
pub(crate) fn ladder(length: f64) -> Parts {
    let mut ladder = Parts::of(STEEL);
    for y in [-0.22, 0.22] {
        ladder.block([-0.015, y - 0.03, 0.0], [0.015, y + 0.03, length]);
    }
    for i in 1..(length / 0.28) as u32 {
        let z = 0.28 * f64::from(i);
        ladder.tube([0.0, -0.23, z], [0.0, 0.23, z], 0.016);
    }
    ladder
}

/// Pipes along x from 0, fixed to a wall at y = 0 behind them, with flanges, a branch with a valve, and clamps.
pub(crate) fn wall_pipes(length: f64, heights: &[f64]) -> Parts {
    let mut pipes = Parts::of(STEEL);
    for (i, &z) in heights.iter().enumerate() {
        let radius = pick_radius(i);
        let y = -radius - 0.08;
        pipes.tube([0.0, y, z], [length, y, z], radius);
        for k in 0..(length / 2.4) as u32 {
            let x = 0.6 + 2.4 * f64::from(k);
            pipes.block(
                [x, y - radius - 0.015, z - radius - 0.015],
                [x + 0.04, 0.02, z + radius + 0.015],
            );
            pipes.tube([x + 1.2, y, z], [x + 1.26, y, z], radius + 0.045);
        }
        let valve = length * (0.3 + 0.2 * i as f64);
        pipes.tube([valve, y, z - 0.02], [valve, y - 0.3, z], 0.5 * radius);
        pipes.tube([valve, y - 0.28, z], [valve, y - 0.31, z], 0.13);
    }
    pipes
}

fn pick_radius(i: usize) -> f64 {
    [0.09, 0.055, 0.12][i % 3]
}

/// A round ventilation duct along x from 0, hanging from z = 0, with outlets.
pub(crate) fn duct(length: f64, drop: f64) -> Parts {
    let mut duct = Parts::of(0.6);
    let z = -drop;
    duct.tube([0.0, 0.0, z], [length, 0.0, z], 0.3);
    for i in 0..(length / 3.0) as u32 {
        let x = 1.0 + 3.0 * f64::from(i);
        duct.tube([x, 0.0, z], [x + 0.05, 0.0, z], 0.325);
        duct.cone([x + 1.2, 0.0, z - 0.48], [x + 1.2, 0.0, z - 0.2], 0.22, 0.14);
        for y in [-0.31, 0.31] {
            duct.tube([x + 0.02, y, z], [x + 0.02, y, 0.02], 0.01);
        }
    }
    duct
}

/// A fan in a wall opening: a ring around blades, its axis along y.
pub(crate) fn wall_fan() -> Parts {
    let mut fan = Parts::of(STEEL);
    fan.tube([0.0, -0.12, 0.0], [0.0, 0.05, 0.0], 0.12);
    for i in 0..4 {
        let angle = TAU * f64::from(i) / 4.0 + 0.3;
        let mut blade = Parts::of(STEEL);
        blade.block([-0.08, -0.01, 0.08], [0.08, 0.01, 0.56]);
        let rotation = DQuat::from_rotation_y(angle) * DQuat::from_rotation_z(0.5);
        fan.place(
            blade,
            &Pose {
                rotation,
                translation: DVec3::new(0.0, -0.05, 0.0),
            },
        );
    }
    for i in 0..16 {
        let angle = TAU * f64::from(i) / 16.0;
        let mut segment = Parts::of(STEEL);
        segment.block([-0.13, -0.14, 0.54], [0.13, 0.06, 0.6]);
        let rotation = DQuat::from_rotation_y(angle);
        fan.place(
            segment,
            &Pose {
                rotation,
                translation: DVec3::ZERO,
            },
        );
    }
    fan
}
