//! A street along x: carriageway to |y| = 6 m, pavements to 10 m, houses beyond.
//!
//! ```text
//!   |y|   0 ─ 3.8 lanes ─ 6 parked cars ┆kerb┆ 6.6 lamps, signs ─ 7.8 trees, shelters ─ 10.6 fronts or gardens ─ 20
//! ```

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DMat3, DQuat, DVec3};
use rand::RngExt;
use tsdfuse::Pose;

use crate::objects::{self, Building, Parts, Rng, pick};
use crate::primitive::{Primitive, Terrain};

const HALF_LENGTH_M: f64 = 60.0;
const HALF_WIDTH_M: f64 = 26.0;
const KERB_M: f64 = 6.0;
const FRONT_M: f64 = 10.8;
const ASPHALT: f64 = 0.18;

/// All solids; `None` never happens with the numbers below.
pub(super) fn street(rng: &mut Rng) -> Option<Vec<Primitive>> {
    let ground = ground(rng)?;
    let mut street = Parts::of(ASPHALT);
    street.add(Primitive::terrain(ground.clone()));
    for side in [-1.0, 1.0] {
        let side = Side {
            ground: &ground,
            sign: side,
        };
        houses(&mut street, rng, &side);
        parked(&mut street, rng, &side);
        kerbside(&mut street, rng, &side);
        pavement(&mut street, rng, &side);
    }
    wires(&mut street, &ground);
    let hump = ground_pose(&ground, rng.random_range(8.0..14.0), 0.0, 0.0);
    street.place(objects::speed_hump(3.2), &hump);
    Some(street.solids)
}

/// One side of the street. Its frame: x along the street, y outwards from the road; the objects' −y faces the road.
struct Side<'a> {
    ground: &'a Terrain,
    sign: f64,
}

impl Side<'_> {
    fn height(&self, x: f64, y: f64) -> f64 {
        self.ground.height_m(x, self.sign * y)
    }

    /// Puts a thing at (x, |y|), its −y towards the road, on the ground.
    fn put(&self, street: &mut Parts, thing: Parts, x: f64, y: f64, yaw: f64) {
        let facing = if self.sign > 0.0 { 0.0 } else { PI };
        street.put(thing, x, self.sign * y, self.height(x, y), facing + yaw);
    }

    /// Puts a thing that starts at x = 0 so that it runs from x to x + `length`, tilted along the ground.
    fn put_along(&self, street: &mut Parts, thing: Parts, x: f64, length: f64, y: f64) {
        let (a, b) = (self.height(x, y), self.height(x + length, y));
        let (start, rise) = if self.sign > 0.0 {
            (x, b - a)
        } else {
            (x + length, a - b)
        };
        let facing = if self.sign > 0.0 { 0.0 } else { PI };
        let pose = Pose {
            rotation: DQuat::from_rotation_z(facing) * DQuat::from_rotation_y(-(rise / length).atan()),
            translation: DVec3::new(start, self.sign * y, self.height(start, y)),
        };
        street.place(thing, &pose);
    }
}

/// The road: up to 3 % uphill, undulating; a crown of 1.5 %, kerbs of 13 cm, pavements that drain to the road.
fn ground(rng: &mut Rng) -> Option<Terrain> {
    let slope = rng.random_range(0.01..0.03);
    let waves = [17.0, 41.0].map(|length| (length, rng.random_range(0.02..0.08), rng.random_range(0.0..TAU)));
    let along = (0..=2 * HALF_LENGTH_M as u32).map(|i| {
        let x = f64::from(i) - HALF_LENGTH_M;
        let wave = |(length, height, phase): (f64, f64, f64)| height * (TAU * x / length + phase).sin();
        slope * x + waves.into_iter().map(wave).sum::<f64>()
    });
    let half = [
        (0.0, 0.0),
        (KERB_M, -0.09),
        (KERB_M, 0.04),
        (10.0, 0.12),
        (HALF_WIDTH_M, 0.2),
    ];
    let across = half
        .iter()
        .rev()
        .map(|&(y, z)| (-y, z))
        .chain(half[1..].iter().copied());
    Terrain::new(-HALF_LENGTH_M, 1.0, along.collect(), across.collect())
}

/// The pose of something that lies on the ground, turned by `yaw` about the ground's normal.
fn ground_pose(ground: &Terrain, x: f64, y: f64, yaw: f64) -> Pose {
    const REACH: f64 = 0.8;
    let z = |dx: f64, dy: f64| ground.height_m(x + dx, y + dy);
    let along = DVec3::new(2.0 * REACH, 0.0, z(REACH, 0.0) - z(-REACH, 0.0)).normalize();
    let across = DVec3::new(0.0, 2.0 * REACH, z(0.0, REACH) - z(0.0, -REACH));
    let up = along.cross(across).normalize();
    let tilt = DQuat::from_mat3(&DMat3::from_cols(along, up.cross(along), up));
    Pose {
        rotation: tilt * DQuat::from_rotation_z(yaw),
        translation: DVec3::new(x, y, z(0.0, 0.0)),
    }
}

/// Houses in a row, now and then a gap; one gap on each side has stairs up to a terrace.
fn houses(street: &mut Parts, rng: &mut Rng, side: &Side) {
    let mut x = -HALF_LENGTH_M + 0.5;
    let mut number = 0;
    while x < HALF_LENGTH_M - 9.0 {
        let width = rng.random_range(9.0..16.0_f64).min(HALF_LENGTH_M - 0.5 - x);
        let garden = number % 3 == 2;
        let house = Building {
            width,
            storeys: rng.random_range(2..5),
            shop: !garden && rng.random_range(0..3_u32) == 0,
            saddle_roof: rng.random_range(0..3_u32) > 0,
            balconies: rng.random_range(0..5_u32) < 2,
        };
        let front = if garden { FRONT_M + 2.6 } else { FRONT_M };
        side.put(street, objects::building(rng, &house), x + width / 2.0, front, 0.0);
        if garden {
            front_garden(street, rng, side, x, width);
        }
        x += width;
        // Gaps: a terrace near the middle, then alleys closed by a wall, a hedge or a fence.
        if (-8.0..6.0).contains(&x) && number >= 2 {
            side.put(street, objects::terrace(), x + 2.0, FRONT_M - 0.6, 0.0);
            x += 4.0;
        } else if rng.random_range(0..3_u32) == 0 {
            let gap = rng.random_range(2.5..4.0);
            let closing = match rng.random_range(0..3_u32) {
                0 => objects::garden_wall(gap),
                1 => objects::hedge(rng, gap),
                _ => objects::picket_fence(gap),
            };
            side.put_along(street, closing, x, gap, FRONT_M + 0.3);
            x += gap;
        }
        number += 1;
    }
}

/// A fence or hedge along the pavement, open in the middle, and something green behind it.
fn front_garden(street: &mut Parts, rng: &mut Rng, side: &Side, x: f64, width: f64) {
    let length = width / 2.0 - 0.9;
    let hedged = rng.random_range(0..2_u32) == 0;
    for start in [x + 0.2, x + width / 2.0 + 0.7] {
        let border = if hedged {
            objects::hedge(rng, length)
        } else {
            objects::picket_fence(length)
        };
        side.put_along(street, border, start, length, FRONT_M - 0.1);
        let conifer = objects::conifer(rng);
        if rng.random_range(0..2_u32) == 0 {
            side.put(street, conifer, start + 0.3 * length, FRONT_M + 1.35, 0.0);
        }
    }
}

/// Cars and vans along the kerb, with free places.
fn parked(street: &mut Parts, rng: &mut Rng, side: &Side) {
    let mut x = -HALF_LENGTH_M + 5.0;
    while x < HALF_LENGTH_M - 5.0 {
        let vehicle = match rng.random_range(0..8_u32) {
            0 | 1 => None,
            2 => Some(objects::van(rng)),
            _ => Some(objects::car(rng)),
        };
        if let Some(vehicle) = vehicle {
            let (y, yaw) = (rng.random_range(4.8..4.92), rng.random_range(-0.03..0.03));
            // Mostly in the direction of traffic, which keeps to the right.
            let with_traffic = if side.sign < 0.0 { 0.0 } else { PI };
            let turn = pick(rng, &[0.0, 0.0, 0.0, PI]);
            let pose = ground_pose(side.ground, x, side.sign * y, with_traffic + turn + yaw);
            street.place(vehicle, &pose);
        }
        x += rng.random_range(6.0..7.2);
    }
}

/// What stands beside the kerb: lamps every 24 m, between them signs, bollards, hydrants, cabinets, bins.
fn kerbside(street: &mut Parts, rng: &mut Rng, side: &Side) {
    let y = KERB_M + 0.6;
    for slot in 0..29_u32 {
        let x = -56.0 + 4.0 * f64::from(slot);
        if slot % 6 == 2 {
            side.put(street, objects::lamp(), x, y, -FRAC_PI_2);
            continue;
        }
        let thing = match rng.random_range(0..12_u32) {
            0 | 1 => objects::sign(rng),
            2 => objects::hydrant(),
            3 => objects::cabinet(),
            4 | 5 => objects::bin(),
            6 | 7 => {
                for dx in [-1.2, 0.0, 1.2] {
                    side.put(street, objects::bollard(), x + dx, y - 0.2, 0.0);
                }
                continue;
            }
            _ => continue,
        };
        // So that signs face oncoming traffic.
        side.put(street, thing, x, y, PI);
    }
}

/// Trees, and what people sit on, wait under and lock their bicycles to.
fn pavement(street: &mut Parts, rng: &mut Rng, side: &Side) {
    for slot in 0..18_u32 {
        let x = -54.0 + 6.2 * f64::from(slot) + rng.random_range(-0.4..0.4);
        let y = KERB_M + 1.9;
        match rng.random_range(0..9_u32) {
            0..=3 => side.put(street, objects::tree(rng), x, y, 0.0),
            4 => side.put(street, objects::bench(), x, y + 0.6, 0.0),
            5 => side.put(street, objects::bicycle_stands(), x, y, 0.0),
            6 => {
                for dx in [-1.1, 1.1] {
                    side.put(street, objects::planter(rng), x + dx, y, 0.0);
                }
            }
            7 => side.put(street, objects::shelter(), x, y, 0.0),
            _ => {}
        }
    }
}

/// Two wires across the road between opposite lamp posts, sagging.
fn wires(street: &mut Parts, ground: &Terrain) {
    street.material(0.1);
    for x in [-24.0, 24.0] {
        let y = KERB_M + 0.6;
        let top = |s: f64| {
            let post = ground.height_m(x, y) + 6.0;
            [x, y * s, post - 0.35 * (1.0 - s * s)]
        };
        for i in 0..12 {
            let s = f64::from(i) / 6.0 - 1.0;
            street.tube(top(s), top(s + 1.0 / 6.0), 0.008);
        }
        let [_, _, z] = top(0.0);
        street.tube([x, 0.0, z - 0.3], [x, 0.0, z], 0.01);
        street.ball([x, 0.0, z - 0.38], [0.2, 0.2, 0.1]);
    }
}
