//! What is kept and used in a hall.

use rand::RngExt;

use super::parts::{Parts, Rng, SUNK_M, pick};

const STEEL: f64 = 0.35;
const WOOD: f64 = 0.4;
const CARDBOARD: f64 = 0.5;
const CONCRETE: f64 = 0.3;

/// A pallet rack along x from 0, 1 m deep, loaded with boxes.
pub(crate) fn rack(rng: &mut Rng, bays: u32, levels: u32) -> Parts {
    const BAY: f64 = 2.0;
    const LEVEL: f64 = 1.15;
    let mut rack = Parts::of(STEEL);
    let height = LEVEL * f64::from(levels - 1) + 0.75;
    for i in 0..=bays {
        let x = BAY * f64::from(i);
        for y in [-0.48, 0.48] {
            rack.block([x - 0.035, y - 0.035, -SUNK_M], [x + 0.035, y + 0.035, height]);
            rack.block([x - 0.08, y - 0.08, -SUNK_M], [x + 0.08, y + 0.08, 0.015]);
        }
        // Bracing in zigzag.
        let zigzag = (height / 0.9) as u32;
        for k in 0..zigzag {
            let (low, high) = (0.15 + 0.85 * f64::from(k), 0.15 + 0.85 * f64::from(k + 1));
            let side = if k % 2 == 0 { 0.46 } else { -0.46 };
            rack.tube([x, -side, low], [x, side, high], 0.015);
        }
    }
    let length = BAY * f64::from(bays);
    for level in 0..levels {
        let z = 0.12 + LEVEL * f64::from(level);
        rack.material(STEEL);
        for y in [-0.48, 0.48] {
            rack.block([0.0, y - 0.03, z - 0.1], [length, y + 0.03, z]);
        }
        rack.material(WOOD);
        rack.block([0.02, -0.47, z - 0.02], [length - 0.02, 0.47, z]);
        for bay in 0..bays {
            load(&mut rack, rng, BAY * f64::from(bay) + 0.08, z);
        }
    }
    rack
}

/// Boxes and drums side by side on one shelf of 1.85 m.
fn load(rack: &mut Parts, rng: &mut Rng, start: f64, z: f64) {
    let mut x = start;
    loop {
        let width = rng.random_range(0.3..0.75);
        if x + width > start + 1.85 {
            break;
        }
        let height = rng.random_range(0.25..0.85);
        let centre = x + width / 2.0;
        match rng.random_range(0..10_u32) {
            0 | 1 => {}
            2 if width < 0.55 => {
                rack.material(STEEL);
                rack.tube([centre, 0.0, z - SUNK_M], [centre, 0.0, z + height], 0.45 * width);
            }
            _ => {
                rack.material(CARDBOARD);
                let depth = rng.random_range(0.4..0.85) / 2.0;
                let yaw = rng.random_range(-0.06..0.06);
                rack.put(
                    carton([0.45 * width, depth, height]),
                    centre,
                    rng.random_range(-0.04..0.04),
                    z,
                    yaw,
                );
            }
        }
        x += width + rng.random_range(0.03..0.25);
    }
}

/// A closed carton: half extents in x and y, height.
fn carton([x, y, height]: [f64; 3]) -> Parts {
    let mut carton = Parts::of(CARDBOARD);
    carton.block([-x, -y, -SUNK_M], [x, y, height]);
    carton
}

/// A wooden pallet, 1.2 m × 0.8 m.
fn pallet() -> Parts {
    let mut pallet = Parts::of(WOOD);
    for i in 0..5 {
        let y = -0.4 + 0.175 * f64::from(i);
        pallet.block([-0.6, y, 0.12], [0.6, y + 0.1, 0.144]);
    }
    for x in [-0.6, -0.0725, 0.455] {
        pallet.block([x, -0.4, 0.098], [x + 0.145, 0.4, 0.122]);
        for y in [-0.4, -0.05, 0.3] {
            pallet.block([x, y, 0.02], [x + 0.145, y + 0.1, 0.1]);
        }
    }
    for y in [-0.4, -0.05, 0.3] {
        pallet.block([-0.6, y, -SUNK_M], [0.6, y + 0.1, 0.022]);
    }
    pallet
}

/// A pallet with a full layer of cartons and some of a second.
pub(crate) fn loaded_pallet(rng: &mut Rng) -> Parts {
    let mut stack = pallet();
    let height = rng.random_range(0.3..0.45);
    for x in [-0.3, 0.3] {
        for y in [-0.2, 0.2] {
            for layer in 0..=rng.random_range(0..2_u32) {
                let yaw = rng.random_range(-0.04..0.04);
                stack.put(
                    carton([0.28, 0.18, height]),
                    x,
                    y,
                    0.144 + height * f64::from(layer),
                    yaw,
                );
            }
        }
    }
    stack
}

/// A steel drum with rolling hoops.
pub(crate) fn barrel() -> Parts {
    let mut barrel = Parts::of(STEEL);
    barrel.tube([0.0, 0.0, -SUNK_M], [0.0, 0.0, 0.87], 0.285);
    for z in [0.0, 0.285, 0.575, 0.86] {
        barrel.tube([0.0, 0.0, z], [0.0, 0.0, z + 0.025], 0.3);
    }
    barrel.tube([0.17, 0.0, 0.86], [0.17, 0.0, 0.89], 0.035);
    barrel
}

/// A gas cylinder.
pub(crate) fn gas_cylinder() -> Parts {
    let mut bottle = Parts::of(STEEL);
    bottle.tube([0.0, 0.0, -SUNK_M], [0.0, 0.0, 1.3], 0.115);
    bottle.ball([0.0, 0.0, 1.3], [0.115, 0.115, 0.13]);
    bottle.tube([0.0, 0.0, 1.4], [0.0, 0.0, 1.53], 0.04);
    bottle.tube([0.0, 0.0, 1.5], [0.07, 0.0, 1.5], 0.015);
    bottle
}

/// A traffic cone.
pub(crate) fn traffic_cone() -> Parts {
    let mut cone = Parts::of(0.7);
    cone.block([-0.19, -0.19, -SUNK_M], [0.19, 0.19, 0.035]);
    cone.cone([0.0, 0.0, 0.03], [0.0, 0.0, 0.7], 0.15, 0.025);
    cone
}

/// A reel of cable, lying on its rims, its axis along y.
pub(crate) fn cable_drum() -> Parts {
    let mut drum = Parts::of(WOOD);
    let at = |y: f64| [0.0, y, 0.6 - SUNK_M];
    for y in [-0.45, 0.39] {
        drum.tube(at(y), at(y + 0.06), 0.6);
    }
    drum.material(0.08);
    drum.tube(at(-0.42), at(0.42), 0.4);
    drum.material(STEEL);
    drum.tube(at(-0.5), at(0.5), 0.05);
    drum
}

/// A work bench with a vice and tools.
pub(crate) fn work_bench() -> Parts {
    let mut bench = Parts::of(WOOD);
    bench.block([-0.9, -0.38, 0.82], [0.9, 0.38, 0.88]);
    for x in [-0.82, 0.76] {
        for y in [-0.33, 0.27] {
            bench.block([x, y, -SUNK_M], [x + 0.06, y + 0.06, 0.83]);
        }
    }
    bench.block([-0.82, -0.33, 0.2], [0.82, 0.33, 0.23]);
    bench.block([-0.5, -0.3, 0.22], [0.1, 0.25, 0.5]);
    bench.material(STEEL);
    bench.block([0.45, -0.4, 0.87], [0.6, -0.2, 1.0]);
    bench.block([0.45, -0.47, 0.9], [0.6, -0.43, 1.0]);
    bench.tube([0.525, -0.6, 0.93], [0.525, -0.3, 0.93], 0.02);
    bench.tube([-0.5, 0.1, 0.87], [-0.5, 0.1, 1.15], 0.09);
    bench.block([-0.2, 0.0, 0.87], [0.15, 0.3, 1.05]);
    bench
}

/// A lathe along x.
pub(crate) fn machine() -> Parts {
    let mut lathe = Parts::of(0.45);
    lathe.block([-1.2, -0.4, -SUNK_M], [1.2, 0.4, 0.75]);
    lathe.block([-1.25, -0.45, 0.7], [-0.6, 0.45, 1.45]);
    lathe.block([0.75, -0.2, 0.7], [1.1, 0.2, 1.15]);
    lathe.profile(&[[-0.25, 0.7], [0.35, 0.7], [0.2, 0.92], [-0.1, 0.92]], [-0.35, 0.35]);
    lathe.material(STEEL);
    lathe.tube([-0.65, 0.0, 1.05], [-0.35, 0.0, 1.05], 0.2);
    lathe.tube([-0.4, 0.0, 1.05], [0.6, 0.0, 1.05], 0.06);
    lathe.cone([0.55, 0.0, 1.05], [0.78, 0.0, 1.05], 0.01, 0.09);
    lathe.tube([0.1, -0.33, 0.8], [0.1, -0.5, 0.8], 0.02);
    lathe.tube([0.1, -0.48, 0.8], [0.1, -0.51, 0.8], 0.1);
    lathe.tube([-0.9, 0.3, 1.4], [-0.9, 0.3, 1.9], 0.03);
    lathe.ball([-0.9, 0.3, 1.95], [0.07; 3]);
    lathe
}

/// A lying tank along y on two saddles.
pub(crate) fn tank() -> Parts {
    let mut tank = Parts::of(0.5);
    tank.tube([0.0, -1.4, 1.35], [0.0, 1.4, 1.35], 0.85);
    for y in [-1.4, 1.4] {
        tank.ball([0.0, y, 1.35], [0.85, 0.4, 0.85]);
    }
    tank.tube([0.0, 0.0, 2.1], [0.0, 0.0, 2.4], 0.25);
    tank.tube([0.0, 0.0, 2.38], [0.0, 0.0, 2.45], 0.33);
    tank.material(CONCRETE);
    for y in [-0.95, 0.95] {
        tank.profile(
            &[[-0.75, -SUNK_M], [0.75, -SUNK_M], [0.6, 0.9], [-0.6, 0.9]],
            [y - 0.12, y + 0.12],
        );
    }
    tank
}

/// A crate of boards, its size chosen at random, turned by its placing.
pub(crate) fn crate_box(rng: &mut Rng) -> Parts {
    let mut wood = Parts::of(WOOD);
    let [x, y] = [0.0, 0.0].map(|_: f64| rng.random_range(0.25..0.5));
    let height = pick(rng, &[0.5, 0.7, 0.9]);
    wood.block([-x, -y, -SUNK_M], [x, y, height]);
    for z in [0.03, height - 0.11] {
        wood.block([-x - 0.02, -y - 0.02, z], [x + 0.02, y + 0.02, z + 0.08]);
    }
    for side in [-x - 0.015, x - 0.065] {
        wood.block([side, -y - 0.015, 0.0], [side + 0.08, y + 0.015, height + 0.01]);
    }
    wood
}
