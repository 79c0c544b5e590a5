//! Town houses: a pierced front with recessed windows, doors, cornices, balconies, and a roof.

use std::f64::consts::FRAC_PI_2;

use glam::DVec2;
use rand::RngExt;

use super::parts::{Opening, Parts, Rng, pick};
use crate::primitive::Primitive;

/// How deep windows and doors lie in the front.
const RECESS_M: f64 = 0.2;
const STOREY_M: f64 = 3.1;
/// How far the walls reach below the ground.
const CELLAR_M: f64 = 1.0;
/// From the pavement up to the ground floor.
const PLINTH_M: f64 = 0.48;
const DEPTH_M: f64 = 9.0;

const PLASTER: f64 = 0.5;
const STONE: f64 = 0.35;
const GLASS: f64 = 0.06;
const METAL: f64 = 0.3;

/// What a house looks like.
pub(crate) struct Building {
    pub(crate) width: f64,
    pub(crate) storeys: u32,
    /// A wide shop window beside the door, under an awning.
    pub(crate) shop: bool,
    /// Saddle roof with chimneys, or flat with a parapet.
    pub(crate) saddle_roof: bool,
    pub(crate) balconies: bool,
}

/// One bay of the front: a window axis.
struct Bay {
    centre: f64,
    half: f64,
}

/// A house along x, centred, its front in the plane y = 0 facing −y, the pavement at z = 0.
pub(crate) fn building(rng: &mut Rng, style: &Building) -> Parts {
    let plaster = rng.random_range(0.8..1.2) * PLASTER;
    let mut house = Parts::of(plaster);
    let half = style.width / 2.0;
    let top = PLINTH_M + STOREY_M * f64::from(style.storeys) + 0.4;
    let count = ((style.width - 0.8) / 2.6) as u32;
    let pitch = (style.width - 0.8) / f64::from(count);
    let window_half = rng.random_range(0.48..0.62);
    let bays: Vec<Bay> = (0..count)
        .map(|i| Bay {
            centre: -half + 0.4 + pitch * (f64::from(i) + 0.5),
            half: window_half,
        })
        .collect();
    let door = rng.random_range(0..count) as usize;

    let mut openings = Vec::new();
    for (i, bay) in bays.iter().enumerate() {
        for storey in 0..style.storeys {
            let floor = PLINTH_M + STOREY_M * f64::from(storey);
            let (sill, head) = match (storey, i == door) {
                (0, true) => (0.0, 2.35),
                (0, false) if style.shop => (0.35, 2.4),
                _ => (0.85, 2.35),
            };
            let x = [bay.centre - bay.half, bay.centre + bay.half];
            let z = [floor + sill, floor + head];
            openings.push(Opening { x, z });
            if (storey, i) == (0, door) {
                door_leaf(&mut house, x, z);
            } else {
                window(&mut house, x, z);
            }
        }
    }
    house.material(plaster);
    house.pierced_wall([-half, half], [0.0, RECESS_M + 0.1], [-CELLAR_M, top], &openings);
    // Behind the front: glass where there is an opening, walls on the other sides.
    house.material(GLASS);
    house.block(
        [-half + 0.05, RECESS_M, -CELLAR_M],
        [half - 0.05, RECESS_M + 0.5, top - 0.05],
    );
    house.material(plaster);
    house.block([-half, RECESS_M + 0.05, -CELLAR_M], [half, DEPTH_M, top]);

    entrance(&mut house, &bays[door], style.shop);
    trim(&mut house, half, top, style);
    if style.shop {
        awning(&mut house, &bays, door);
    }
    if style.balconies {
        for storey in 1..style.storeys {
            for bay in bays.iter().skip(storey as usize % 2).step_by(2) {
                balcony(&mut house, bay, PLINTH_M + STOREY_M * f64::from(storey));
            }
        }
    }
    if style.saddle_roof {
        saddle_roof(&mut house, rng, half, top);
    } else {
        flat_roof(&mut house, rng, half, top);
    }
    house
}

/// Frame, crossbars and a sill.
fn window(house: &mut Parts, x: [f64; 2], z: [f64; 2]) {
    let y = [RECESS_M - 0.06, RECESS_M + 0.02];
    house.material(0.8);
    for edge in [x[0] - 0.01, x[1] - 0.05] {
        house.block([edge, y[0], z[0]], [edge + 0.06, y[1], z[1]]);
    }
    for edge in [z[0] - 0.01, z[1] - 0.05] {
        house.block([x[0], y[0], edge], [x[1], y[1], edge + 0.06]);
    }
    let (middle, transom) = ((x[0] + x[1]) / 2.0, z[0] + 0.68 * (z[1] - z[0]));
    house.block([middle - 0.03, y[0] + 0.01, z[0]], [middle + 0.03, y[1], z[1]]);
    house.block([x[0], y[0] + 0.01, transom - 0.025], [x[1], y[1], transom + 0.025]);
    house.material(STONE);
    house.block(
        [x[0] - 0.1, -0.07, z[0] - 0.08],
        [x[1] + 0.1, RECESS_M + 0.02, z[0] + 0.005],
    );
}

/// A panelled door leaf with a knob.
fn door_leaf(house: &mut Parts, x: [f64; 2], z: [f64; 2]) {
    let middle = (x[0] + x[1]) / 2.0;
    house.material(0.25);
    house.block(
        [x[0] - 0.01, RECESS_M - 0.05, z[0] - 0.01],
        [x[1] + 0.01, RECESS_M + 0.02, z[1] + 0.01],
    );
    for [left, right] in [[x[0] + 0.1, middle - 0.06], [middle + 0.06, x[1] - 0.1]] {
        for [low, high] in [[0.15, 0.85], [1.0, 1.95]] {
            house.block([left, RECESS_M - 0.075, z[0] + low], [right, RECESS_M, z[0] + high]);
        }
    }
    house.material(METAL);
    house.ball([middle + 0.02, RECESS_M - 0.09, z[0] + 0.95], [0.035, 0.05, 0.035]);
}

/// Steps up to the door, jambs and a canopy.
fn entrance(house: &mut Parts, bay: &Bay, plain: bool) {
    house.material(STONE);
    let mut steps = Parts::of(STONE);
    steps.steps(3, PLINTH_M / 3.0, 0.3, 0.6, [-bay.half - 0.25, bay.half + 0.25]);
    house.put(steps, bay.centre, -0.895, 0.0, FRAC_PI_2);
    // The threshold, through the wall.
    let (left, right) = (bay.centre - bay.half, bay.centre + bay.half);
    house.block([left - 0.02, -0.02, -0.5], [right + 0.02, RECESS_M, PLINTH_M]);
    for x in [left - 0.16, right] {
        house.block([x, -0.06, PLINTH_M - 0.02], [x + 0.16, 0.05, PLINTH_M + 2.45]);
    }
    house.block(
        [left - 0.22, -0.1, PLINTH_M + 2.35],
        [right + 0.22, 0.05, PLINTH_M + 2.52],
    );
    if !plain {
        // A pediment.
        let mut pediment = Parts::of(STONE);
        let reach = bay.half + 0.3;
        let base = PLINTH_M + 2.5;
        pediment.profile(&[[-reach, base], [reach, base], [0.0, base + 0.38]], [-0.16, 0.05]);
        house.put(pediment, bay.centre, 0.0, 0.0, 0.0);
    }
}

/// Plinth, cornices between the storeys, the main cornice, a downpipe.
fn trim(house: &mut Parts, half: f64, top: f64, style: &Building) {
    house.material(STONE);
    for storey in 1..style.storeys {
        let z = PLINTH_M + STOREY_M * f64::from(storey) - 0.12;
        house.block([-half, -0.06, z], [half, 0.05, z + 0.14]);
    }
    // The main cornice's moulding: an outline over y and z, extruded along x.
    let moulding = [
        [0.05, top - 0.42],
        [-0.05, top - 0.42],
        [-0.08, top - 0.3],
        [-0.2, top - 0.18],
        [-0.2, top - 0.12],
        [-0.32, top - 0.08],
        [-0.32, top + 0.02],
        [0.05, top + 0.02],
    ];
    house.add(along_x(&moulding, half));
    house.material(METAL);
    let x = half - 0.12;
    house.tube([x, -0.14, -0.3], [x, -0.14, top - 0.2], 0.045);
    for storey in 0..style.storeys {
        let z = PLINTH_M + STOREY_M * (f64::from(storey) + 0.5);
        house.block([x - 0.06, -0.16, z], [x + 0.06, 0.05, z + 0.03]);
    }
}

/// An outline over (y, z), extruded over |x| ≤ `half`.
fn along_x(outline: &[[f64; 2]], half: f64) -> Primitive {
    let outline = outline.iter().copied().map(DVec2::from).collect();
    Primitive::profile(outline, 2.0 * half).turned(FRAC_PI_2)
}

/// A sign board, and an awning over the shop windows on each side of the door.
fn awning(house: &mut Parts, bays: &[Bay], door: usize) {
    let z = PLINTH_M + 2.45;
    for part in [&bays[..door], &bays[door + 1..]] {
        let ([first, ..], [.., last]) = (part, part) else {
            continue;
        };
        let (left, right) = (first.centre - first.half - 0.15, last.centre + last.half + 0.15);
        house.material(0.6);
        house.block([left, -0.07, z + 0.12], [right, 0.05, z + 0.45]);
        let cloth = [
            [0.02, z + 0.1],
            [-1.1, z - 0.35],
            [-1.1, z - 0.42],
            [-1.07, z - 0.42],
            [-1.07, z - 0.37],
            [0.02, z + 0.07],
        ];
        let (middle, half) = ((left + right) / 2.0, (right - left) / 2.0);
        house.add(along_x(&cloth, half).at(middle, 0.0, 0.0));
        house.material(METAL);
        for x in [left + 0.05, right - 0.05] {
            house.tube([x, 0.02, z - 0.5], [x, -1.08, z - 0.37], 0.015);
        }
    }
}

/// A slab on brackets with a railing.
fn balcony(house: &mut Parts, bay: &Bay, floor: f64) {
    let (left, right) = (bay.centre - bay.half - 0.3, bay.centre + bay.half + 0.3);
    house.material(STONE);
    house.block([left, -0.95, floor + 0.25], [right, 0.05, floor + 0.37]);
    for x in [left + 0.15, right - 0.25] {
        let mut bracket = Parts::of(STONE);
        bracket.profile(
            &[[0.0, floor - 0.15], [0.0, floor + 0.27], [0.7, floor + 0.27]],
            [-0.05, 0.05],
        );
        house.put(bracket, x + 0.05, 0.02, 0.0, -FRAC_PI_2);
    }
    house.material(METAL);
    let z = floor + 0.37;
    house.railing([left + 0.04, -0.91, z], [right - 0.04, -0.91, z], 1.0, 0.13);
    for x in [left + 0.04, right - 0.04] {
        house.railing([x, -0.91, z], [x, 0.02, z], 1.0, 0.2);
    }
}

/// A roof with the ridge along x, eaves with a gutter, chimneys and a dormer.
fn saddle_roof(house: &mut Parts, rng: &mut Rng, half: f64, top: f64) {
    let rise = rng.random_range(2.4..3.4);
    let (front, back) = (-0.45, DEPTH_M + 0.4);
    let ridge = (front + back) / 2.0;
    house.material(0.3);
    let outline = [
        [front, top - 0.02],
        [back, top - 0.02],
        [back, top + 0.1],
        [ridge, top + rise],
        [front, top + 0.1],
    ];
    house.add(along_x(&outline, half + 0.15));
    house.material(METAL);
    house.tube(
        [-half - 0.15, front, top + 0.04],
        [half + 0.15, front, top + 0.04],
        0.07,
    );
    // Height of the roof over y in front of the ridge.
    let roof = |y: f64| top + 0.1 + (rise - 0.1) * (y - front) / (ridge - front);
    house.material(STONE);
    for x in [-0.6 * half, 0.55 * half] {
        let z = top + rise;
        house.block([x - 0.3, ridge - 0.25, z - 0.8], [x + 0.3, ridge + 0.25, z + 0.7]);
        house.block([x - 0.36, ridge - 0.31, z + 0.7], [x + 0.36, ridge + 0.31, z + 0.78]);
        for pot in [x - 0.14, x + 0.14] {
            house.cone([pot, ridge, z + 0.76], [pot, ridge, z + 1.1], 0.1, 0.08);
        }
    }
    let mut dormer = Parts::of(PLASTER);
    let (y, z) = (1.0, roof(1.0));
    dormer.block([-0.7, y, z - 0.3], [0.7, y + 2.2, z + 1.1]);
    dormer.material(GLASS);
    dormer.block([-0.45, y - 0.02, z + 0.15], [0.45, y + 0.05, z + 0.95]);
    dormer.material(0.3);
    dormer.profile(&[[-0.9, z + 1.05], [0.9, z + 1.05], [0.0, z + 1.7]], [y - 0.2, y + 2.6]);
    house.put(dormer, pick(rng, &[-0.2, 0.0, 0.2]) * half, 0.0, 0.0, 0.0);
}

/// A flat roof: a parapet around it, ventilation on it.
fn flat_roof(house: &mut Parts, rng: &mut Rng, half: f64, top: f64) {
    house.material(PLASTER);
    let (low, high) = (top - 0.1, top + 0.55);
    house.block([-half, 0.0, low], [half, 0.25, high]);
    house.block([-half, DEPTH_M - 0.25, low], [half, DEPTH_M, high]);
    for x in [-half, half - 0.25] {
        house.block([x, 0.1, low], [x + 0.25, DEPTH_M - 0.1, high]);
    }
    house.material(STONE);
    house.block([-half - 0.04, -0.05, high], [half + 0.04, 0.3, high + 0.07]);
    house.material(METAL);
    for _ in 0..3 {
        let (x, y) = (rng.random_range(-0.7..0.7) * half, rng.random_range(2.0..7.0));
        house.tube([x, y, low], [x, y, top + 0.9], 0.12);
        house.cone([x, y, top + 0.88], [x, y, top + 1.1], 0.24, 0.02);
    }
}
