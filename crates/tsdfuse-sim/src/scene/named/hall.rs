//! A hall, 30 m along x, 20 m along y, 8 m high, its floor at z = 0 about the origin.
//!
//! ```text
//!   |y|   0 ─ 1.3 aisle ─ 2.2 low goods on the floor ─ 5.2 ┆ 6 pillars ┆ 7.4 ─ 8.6 racks, machines ─ 10 wall
//! ```
//!
//! The aisle is free for walking; above the goods, up to the lamps, it is free for flying.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3};
use rand::RngExt;
use tsdfuse::Pose;

use crate::objects::{self, Opening, Parts, Rng, pick};
use crate::primitive::Primitive;

const HALF_X: f64 = 15.0;
const HALF_Y: f64 = 10.0;
const HEIGHT: f64 = 8.0;
const WALL: f64 = 0.3;
const PILLARS_X: [f64; 4] = [-10.0, -10.0 / 3.0, 10.0 / 3.0, 10.0];

pub(super) fn hall(rng: &mut Rng) -> Vec<Primitive> {
    let mut hall = Parts::of(0.35);
    hall.block([-HALF_X - 1.0, -HALF_Y - 1.0, -0.5], [HALF_X + 1.0, HALF_Y + 1.0, 0.0]);
    walls(&mut hall);
    roof(&mut hall);
    for (i, x) in PILLARS_X.into_iter().enumerate() {
        hall.put(objects::pillar(i % 2 == 0, HEIGHT - 0.5), x, 6.0, 0.0, 0.0);
        hall.put(objects::pillar(i % 2 == 1, HEIGHT - 0.5), x, -6.0, 0.0, 0.0);
    }
    along_the_walls(&mut hall, rng);
    on_the_floor(&mut hall, rng);
    overhead(&mut hall);
    hall.solids
}

/// Long walls with a row of open windows, short walls with gates; window frames and gate posts.
fn walls(hall: &mut Parts) {
    let windows: Vec<_> = (0..6)
        .map(|i| {
            let x = -12.5 + 5.0 * f64::from(i);
            Opening {
                x: [x - 1.4, x + 1.4],
                z: [4.0, 6.6],
            }
        })
        .collect();
    for yaw in [0.0, PI] {
        let mut wall = Parts::of(0.5);
        wall.pierced_wall(
            [-HALF_X - WALL, HALF_X + WALL],
            [HALF_Y, HALF_Y + WALL],
            [-0.2, HEIGHT + 0.1],
            &windows,
        );
        wall.material(0.3);
        for w in &windows {
            frame(&mut wall, w, 3);
        }
        hall.put(wall, 0.0, 0.0, 0.0, yaw);
    }
    let gates = [
        vec![
            Opening {
                x: [-6.0, -2.0],
                z: [0.0, 4.2],
            },
            Opening {
                x: [3.0, 4.2],
                z: [0.0, 2.2],
            },
        ],
        vec![Opening {
            x: [-2.2, 2.2],
            z: [0.0, 4.6],
        }],
    ];
    for (gates, yaw) in gates.iter().zip([FRAC_PI_2, -FRAC_PI_2]) {
        let mut wall = Parts::of(0.5);
        wall.pierced_wall(
            [-HALF_Y - WALL, HALF_Y + WALL],
            [HALF_X, HALF_X + WALL],
            [-0.2, HEIGHT + 0.1],
            gates,
        );
        wall.material(0.3);
        for g in gates {
            let y = [HALF_X - 0.06, HALF_X + 0.1];
            for x in [g.x[0] - 0.15, g.x[1]] {
                wall.block([x, y[0], -0.01], [x + 0.15, y[1], g.z[1] + 0.15]);
            }
            wall.block([g.x[0] - 0.15, y[0], g.z[1]], [g.x[1] + 0.15, y[1], g.z[1] + 0.15]);
            if g.z[1] > 3.0 {
                // The rolled-up gate.
                let z = g.z[1] + 0.35;
                wall.tube([g.x[0] - 0.1, y[0] - 0.12, z], [g.x[1] + 0.1, y[0] - 0.12, z], 0.26);
            }
        }
        hall.put(wall, 0.0, 0.0, 0.0, yaw);
    }
}

/// A frame with upright bars in an opening of the wall's inner edge.
fn frame(wall: &mut Parts, opening: &Opening, bars: u32) {
    let y = [HALF_Y + 0.08, HALF_Y + 0.14];
    let ([x0, x1], [z0, z1]) = (opening.x, opening.z);
    for z in [z0 - 0.01, (z0 + z1) / 2.0, z1 - 0.05] {
        wall.block([x0 - 0.01, y[0], z], [x1 + 0.01, y[1], z + 0.06]);
    }
    for i in 0..=bars {
        let x = x0 - 0.01 + (x1 - x0 - 0.04) * f64::from(i) / f64::from(bars);
        wall.block([x, y[0], z0], [x + 0.06, y[1], z1]);
    }
    wall.block(
        [x0 - 0.1, HALF_Y - 0.12, z0 - 0.07],
        [x1 + 0.1, HALF_Y + 0.1, z0 + 0.005],
    );
}

/// Beams across, purlins along, and a deck with open skylights between the beams.
fn roof(hall: &mut Parts) {
    const DECK: f64 = 0.2;
    for y in [-1.0, 1.0] {
        let [a, b] = [4.0 * y, (HALF_Y + WALL) * y];
        hall.block(
            [-HALF_X - WALL, a.min(b), HEIGHT],
            [HALF_X + WALL, a.max(b), HEIGHT + DECK],
        );
    }
    // Across the middle, between the skylights.
    let mut start = -HALF_X - WALL;
    for i in 0..5 {
        let x = -12.0 + 6.0 * f64::from(i);
        hall.block([start, -4.1, HEIGHT], [x - 1.2, 4.1, HEIGHT + DECK]);
        start = x + 1.2;
    }
    hall.block([start, -4.1, HEIGHT], [HALF_X + WALL, 4.1, HEIGHT + DECK]);
    for x in PILLARS_X {
        let beam = objects::i_beam([-HALF_Y - 0.05, HALF_Y + 0.05], 0.52, 0.3);
        hall.put(beam, x, 0.0, HEIGHT + 0.01, 0.0);
    }
    hall.material(0.35);
    for y in [-8.0, -4.5, 4.5, 8.0] {
        hall.block(
            [-HALF_X - 0.05, y - 0.05, HEIGHT - 0.14],
            [HALF_X + 0.05, y + 0.05, HEIGHT + 0.01],
        );
    }
}

/// Racks, a mezzanine, a machine, a tank, gas cylinders, a ladder, pipes.
fn along_the_walls(hall: &mut Parts, rng: &mut Rng) {
    hall.put(objects::rack(rng, 5, 4), -3.0, 8.2, 0.0, 0.0);
    hall.put(objects::rack(rng, 6, 4), -8.5, -8.2, 0.0, 0.0);
    hall.put(objects::mezzanine(3.06, 3.4), -14.6, HALF_Y, 0.0, 0.0);
    hall.put(objects::machine(), -12.4, -8.3, 0.0, 0.0);
    hall.put(objects::tank(), 12.6, 6.9, 0.0, 0.0);
    for i in 0..5 {
        let x = 6.0 + 0.34 * f64::from(i) + rng.random_range(-0.03..0.03);
        hall.put(objects::gas_cylinder(), x, -9.55, 0.0, rng.random_range(0.0..6.0));
    }
    let lean = Pose {
        rotation: DQuat::from_rotation_z(-FRAC_PI_2) * DQuat::from_rotation_y(0.28),
        translation: DVec3::new(9.2, -8.9, -0.01),
    };
    hall.place(objects::ladder(4.0), &lean);
    hall.put(objects::work_bench(), 10.8, -8.9, 0.0, PI);
    hall.put(objects::wall_pipes(27.0, &[6.85, 7.15]), -13.5, HALF_Y, 0.0, 0.0);
    hall.put(objects::wall_pipes(21.0, &[2.9, 3.2, 7.1]), 8.5, -HALF_Y, 0.0, PI);
    hall.put(objects::wall_fan(), HALF_X - 0.05, 7.3, 5.8, -FRAC_PI_2);
}

/// Pallets, crates, barrels, drums and cones on both sides of the aisle, and a forklift.
fn on_the_floor(hall: &mut Parts, rng: &mut Rng) {
    for side in [-1.0, 1.0] {
        for slot in 0..10_u32 {
            let x = -11.3 + 2.5 * f64::from(slot) + rng.random_range(-0.2..0.2);
            let y = side * rng.random_range(3.0..3.9);
            let yaw = rng.random_range(-0.4..0.4) + pick(rng, &[0.0, FRAC_PI_2]);
            let thing = match rng.random_range(0..8_u32) {
                0 | 1 => objects::loaded_pallet(rng),
                2 => objects::crate_box(rng),
                3 => objects::cable_drum(),
                4 => {
                    for (dx, dy) in [(0.0, 0.0), (0.65, 0.1), (0.3, 0.62)] {
                        hall.put(objects::barrel(), x + dx, y + dy, 0.0, yaw);
                    }
                    continue;
                }
                5 => {
                    for dx in [-0.6, 0.0, 0.6] {
                        hall.put(objects::traffic_cone(), x + dx, y, 0.0, yaw);
                    }
                    continue;
                }
                6 => {
                    // The vice towards the aisle.
                    let yaw = rng.random_range(-0.2..0.2) + if side > 0.0 { 0.0 } else { PI };
                    hall.put(objects::work_bench(), x, y, 0.0, yaw);
                    continue;
                }
                _ => continue,
            };
            hall.put(thing, x, y, 0.0, yaw);
        }
    }
    hall.put(objects::forklift(), 9.2, 8.6, 0.0, rng.random_range(-1.75..-1.6));
    hall.material(0.4);
    for y in [3.8, -9.2] {
        hall.ball([14.0, y, 0.44], [0.45; 3]);
    }
}

/// Lamps between the beams and ventilation ducts.
fn overhead(hall: &mut Parts) {
    for x in [-13.0, -6.7, 6.7, 13.0] {
        for y in [-4.5, 4.5] {
            hall.put(objects::hanging_lamp(1.2), x, y, HEIGHT - 0.14, 0.0);
        }
    }
    for y in [-7.0, 7.0] {
        hall.put(objects::duct(24.0, 1.3), -12.0, y, HEIGHT, 0.0);
    }
}
