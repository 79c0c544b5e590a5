//! Street furniture.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec2};
use rand::RngExt;
use tsdfuse::Pose;

use super::parts::{FOOTING_M, Parts, Rng};
use crate::primitive::Primitive;

const STEEL: f64 = 0.35;
const WOOD: f64 = 0.4;
const GLASS: f64 = 0.06;

/// A street lamp whose arm points along +x.
pub(crate) fn lamp() -> Parts {
    let mut lamp = Parts::of(STEEL);
    lamp.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 6.2], 0.09, 0.055);
    lamp.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.7], 0.15, 0.12);
    lamp.tube([0.0, 0.0, 5.6], [1.1, 0.0, 6.25], 0.035);
    lamp.tube([1.1, 0.0, 6.25], [1.8, 0.0, 6.3], 0.035);
    lamp.ball([2.0, 0.0, 6.27], [0.38, 0.16, 0.07]);
    lamp.ball([0.0, 0.0, 6.2], [0.08, 0.08, 0.08]);
    lamp
}

/// A traffic sign that faces −x: a disc, a triangle, an octagon, or a rectangle.
pub(crate) fn sign(rng: &mut Rng) -> Parts {
    let mut sign = Parts::of(STEEL);
    sign.tube([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 2.75], 0.03);
    let corners = |n: u32, radius: f64, phase: f64| -> Vec<DVec2> {
        let at = |i| DVec2::from_angle(phase + TAU * f64::from(i) / f64::from(n)) * radius;
        (0..n).map(at).collect()
    };
    sign.material(0.9);
    let plate = match rng.random_range(0..4_u32) {
        0 => Primitive::cuboid(glam::DVec3::new(0.5, 0.75, 0.012)),
        1 => Primitive::prism(corners(3, 0.45, FRAC_PI_2), 0.012),
        2 => Primitive::prism(corners(8, 0.35, TAU / 16.0), 0.012),
        _ => Primitive::frustum(0.32, 0.32, 0.012),
    };
    // Upright: the plate's x to −y, its y to z, its axis to −x.
    let upright = glam::DMat3::from_cols(-glam::DVec3::Y, glam::DVec3::Z, -glam::DVec3::X);
    sign.add(plate.placed(&Pose {
        rotation: DQuat::from_mat3(&upright),
        translation: glam::DVec3::new(-0.03, 0.0, 2.35),
    }));
    sign
}

/// A waste bin.
pub(crate) fn bin() -> Parts {
    let mut bin = Parts::of(STEEL);
    bin.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.8], 0.2, 0.27);
    bin.tube([0.0, 0.0, 0.78], [0.0, 0.0, 0.84], 0.29);
    bin.ball([0.0, 0.0, 0.84], [0.27, 0.27, 0.14]);
    bin
}

/// A bollard.
pub(crate) fn bollard() -> Parts {
    let mut bollard = Parts::of(STEEL);
    bollard.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.85], 0.08, 0.065);
    bollard.tube([0.0, 0.0, 0.68], [0.0, 0.0, 0.74], 0.085);
    bollard.ball([0.0, 0.0, 0.85], [0.085; 3]);
    bollard
}

/// A fire hydrant.
pub(crate) fn hydrant() -> Parts {
    let mut hydrant = Parts::of(0.3);
    hydrant.tube([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.06], 0.17);
    hydrant.cone([0.0, 0.0, 0.0], [0.0, 0.0, 0.62], 0.12, 0.1);
    hydrant.ball([0.0, 0.0, 0.62], [0.13, 0.13, 0.14]);
    hydrant.tube([0.0, -0.2, 0.45], [0.0, 0.2, 0.45], 0.05);
    hydrant.tube([0.0, 0.0, 0.4], [0.19, 0.0, 0.4], 0.065);
    hydrant
}

/// A bench along x that faces −y.
pub(crate) fn bench() -> Parts {
    let mut bench = Parts::of(STEEL);
    for x in [-0.65, 0.65] {
        bench.block([x - 0.03, -0.2, -FOOTING_M], [x + 0.03, -0.14, 0.42]);
        bench.block([x - 0.03, 0.16, -FOOTING_M], [x + 0.03, 0.22, 0.9]);
        bench.block([x - 0.03, -0.2, 0.38], [x + 0.03, 0.22, 0.425]);
    }
    bench.material(WOOD);
    for i in 0..4 {
        let y = -0.22 + 0.105 * f64::from(i);
        bench.block([-0.85, y, 0.42], [0.85, y + 0.085, 0.455]);
    }
    for z in [0.56, 0.72] {
        bench.block([-0.85, 0.13, z], [0.85, 0.165, z + 0.11]);
    }
    bench
}

/// A row of hoops for bicycles, along x.
pub(crate) fn bicycle_stands() -> Parts {
    let mut stands = Parts::of(STEEL);
    for i in 0..4 {
        let x = -1.2 + 0.8 * f64::from(i);
        for y in [-0.35, 0.35] {
            stands.tube([x, y, -FOOTING_M], [x, y, 0.65], 0.024);
            stands.tube([x, y, 0.65], [x, 0.7 * y, 0.78], 0.024);
            stands.ball([x, y, 0.65], [0.024; 3]);
            stands.ball([x, 0.7 * y, 0.78], [0.024; 3]);
        }
        stands.tube([x, -0.245, 0.78], [x, 0.245, 0.78], 0.024);
    }
    stands
}

/// A cabinet for cables.
pub(crate) fn cabinet() -> Parts {
    let mut cabinet = Parts::of(0.5);
    cabinet.block([-0.5, -0.17, -FOOTING_M], [0.5, 0.17, 1.05]);
    cabinet.block([-0.53, -0.2, 1.05], [0.53, 0.2, 1.1]);
    for x in [-0.24, 0.24] {
        cabinet.block([x - 0.21, -0.185, 0.12], [x + 0.21, -0.1, 0.98]);
    }
    cabinet
}

/// A tub with a small conifer-like shrub.
pub(crate) fn planter(rng: &mut Rng) -> Parts {
    let mut planter = Parts::of(0.3);
    planter.cone([0.0, 0.0, -FOOTING_M], [0.0, 0.0, 0.5], 0.26, 0.38);
    planter.material(0.45);
    let height = rng.random_range(0.3..0.55);
    planter.ball([0.0, 0.0, 0.45 + 0.6 * height], [0.34, 0.34, height]);
    planter
}

/// A bus shelter along x, open towards −y.
pub(crate) fn shelter() -> Parts {
    let mut shelter = Parts::of(STEEL);
    for x in [-1.9, 0.0, 1.9] {
        shelter.block([x - 0.04, 0.5, -FOOTING_M], [x + 0.04, 0.58, 2.4]);
    }
    for x in [-1.9, 1.9] {
        shelter.block([x - 0.03, -0.55, -FOOTING_M], [x + 0.03, -0.49, 2.42]);
    }
    let roof = [[-0.8, 2.36], [0.75, 2.3], [0.75, 2.38], [0.0, 2.52], [-0.8, 2.45]];
    let roof: Vec<DVec2> = roof.into_iter().map(DVec2::from).collect();
    // The outline is over y and z here: a side view turned by a quarter.
    shelter.add(Primitive::profile(roof, 4.2).turned(FRAC_PI_2));
    shelter.block([-1.6, 0.2, 0.42], [1.2, 0.52, 0.47]);
    for x in [-1.4, 1.0] {
        shelter.block([x - 0.03, 0.3, -FOOTING_M], [x + 0.03, 0.4, 0.44]);
    }
    shelter.material(GLASS);
    shelter.block([-1.9, 0.53, 0.15], [1.9, 0.55, 2.2]);
    shelter.block([-1.91, -0.5, 0.15], [-1.89, 0.52, 2.2]);
    shelter
}

/// A picket fence along x from 0.
pub(crate) fn picket_fence(length: f64) -> Parts {
    let mut fence = Parts::of(WOOD);
    let pickets = (length / 0.15) as u32;
    for i in 0..pickets {
        let x = 0.15 * (f64::from(i) + 0.2);
        fence.profile(
            &[
                [x, 0.08],
                [x + 0.08, 0.08],
                [x + 0.08, 0.92],
                [x + 0.04, 1.0],
                [x, 0.92],
            ],
            [-0.035, -0.012],
        );
    }
    for z in [0.25, 0.7] {
        fence.block([0.0, -0.015, z], [length, 0.02, z + 0.07]);
    }
    let posts = (length / 1.8).ceil() as u32;
    for i in 0..=posts {
        let x = 0.04 + (length - 0.08) * f64::from(i) / f64::from(posts);
        fence.block([x - 0.04, 0.01, -0.4], [x + 0.04, 0.09, 0.95]);
    }
    fence
}

/// A garden wall along x from 0, with piers and a coping.
pub(crate) fn garden_wall(length: f64) -> Parts {
    let mut wall = Parts::of(0.35);
    wall.block([0.0, -0.12, -0.5], [length, 0.12, 1.3]);
    wall.block([0.0, -0.16, 1.3], [length, 0.16, 1.38]);
    let piers = (length / 2.5).ceil() as u32;
    for i in 0..=piers {
        let x = 0.18 + (length - 0.36) * f64::from(i) / f64::from(piers);
        wall.block([x - 0.18, -0.18, -0.5], [x + 0.18, 0.18, 1.48]);
        wall.block([x - 0.22, -0.22, 1.48], [x + 0.22, 0.22, 1.54]);
    }
    wall
}

/// Outdoor stairs up along +y from y = 0 to a terrace, 3 m wide about x = 0, with railings.
pub(crate) fn terrace() -> Parts {
    const RISE: f64 = 0.165;
    const STEPS: u32 = 9;
    let mut stairs = Parts::of(0.3);
    stairs.steps(STEPS, RISE, 0.3, 0.4, [-1.5, 1.5]);
    let (end, top) = (0.3 * f64::from(STEPS), RISE * f64::from(STEPS));
    stairs.block([end - 0.02, -1.5, -0.4], [end + 5.0, 1.5, top]);
    stairs.material(STEEL);
    for y in [-1.4, 1.4] {
        stairs.railing([0.15, y, RISE], [end + 0.15, y, top + 0.5 * RISE], 0.9, 1.2);
        stairs.railing([end + 0.2, y, top], [end + 4.9, y, top], 1.0, 0.25);
    }
    let mut turned = Parts::of(0.3);
    turned.put(stairs, 0.0, 0.0, 0.0, FRAC_PI_2);
    turned
}

/// A speed hump across the road: a bump along x, extruded over y.
pub(crate) fn speed_hump(half_width: f64) -> Parts {
    let mut hump = Parts::of(0.15);
    let mut outline = vec![[1.0, -0.2], [-1.0, -0.2]];
    outline.reverse();
    for i in 0..=10 {
        let x = 1.0 - 0.2 * f64::from(i);
        outline.push([x, 0.08 * (x * FRAC_PI_2).cos() - 0.004]);
    }
    hump.profile(&outline, [-half_width, half_width]);
    hump
}
