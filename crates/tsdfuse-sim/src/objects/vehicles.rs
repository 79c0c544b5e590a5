//! Parked vehicles, facing +x, wheels on the ground.

use rand::RngExt;

use super::parts::{Parts, Rng, pick};

const GLASS: f64 = 0.06;
const RUBBER: f64 = 0.05;

/// A saloon, an estate car or a small one.
pub(crate) fn car(rng: &mut Rng) -> Parts {
    let half_length = rng.random_range(1.9..2.25);
    let half_width = rng.random_range(0.84..0.91);
    let boot = pick(rng, &[0.15, 0.3, 0.95]); // from the tail to the foot of the rear window
    let roof = rng.random_range(1.40..1.58);
    let (f, r, w) = (half_length, -half_length, half_width);
    let mut car = Parts::of(rng.random_range(0.08..0.6));
    let body = [
        [r, 0.42],
        [r + 0.12, 0.24],
        [f - 0.18, 0.22],
        [f, 0.36],
        [f - 0.02, 0.6],
        [f - 0.16, 0.71],
        [f - 1.05, 0.86],
        [f - 1.2, 0.91],
        [r + boot, 0.93],
        [r + 0.08, 0.9],
        [r + 0.01, 0.7],
    ];
    car.profile(&body, [-w, w]);
    // Bumpers and the sills between the wheels.
    car.tube([f - 0.03, -w + 0.1, 0.45], [f - 0.03, w - 0.1, 0.45], 0.08);
    car.tube([r + 0.04, -w + 0.1, 0.48], [r + 0.04, w - 0.1, 0.48], 0.08);
    for side in [-1.0, 1.0] {
        let (inner, outer) = (side * (w - 0.1), side * (w + 0.015));
        car.block([-0.28 * f, inner.min(outer), 0.21], [0.28 * f, inner.max(outer), 0.32]);
        car.ball([f - 0.12, side * (w - 0.24), 0.63], [0.14, 0.16, 0.07]);
        car.ball([f - 1.28, side * (w + 0.08), 0.96], [0.07, 0.11, 0.07]);
    }
    let shrink = 0.13;
    let front = f - 1.12;
    let cabin = [
        [front, 0.85],
        [front - 0.78, roof - 0.03],
        [front - 1.1, roof],
        [r + boot + 0.55, roof - 0.03],
        [r + boot + 0.02, 0.88],
    ];
    car.material(GLASS);
    car.profile(&cabin, [-w + shrink, w - shrink]);
    // The roof, and the pillars that frame the windows.
    car.material(0.3);
    let skin = w - shrink + 0.012;
    car.block(
        [r + boot + 0.56, -skin, roof - 0.07],
        [front - 1.08, skin, roof + 0.015],
    );
    let door = 0.5 * (front - 0.9 + r + boot + 0.55);
    car.block([door - 0.05, -skin, 0.85], [door + 0.05, skin, roof - 0.03]);
    wheels(&mut car, &[0.62 * f, -0.6 * f], w, 0.31);
    car
}

/// A panel van.
pub(crate) fn van(rng: &mut Rng) -> Parts {
    let half_length = rng.random_range(2.4..2.8);
    let top = rng.random_range(2.0..2.4);
    let (f, r, w) = (half_length, -half_length, 0.97);
    let mut van = Parts::of(rng.random_range(0.3..0.7));
    let body = [
        [r, 0.32],
        [f - 0.2, 0.28],
        [f, 0.45],
        [f - 0.03, 0.85],
        [f - 0.75, 1.12],
        [f - 1.45, top - 0.1],
        [f - 1.8, top],
        [r + 0.1, top],
        [r, top - 0.15],
    ];
    van.profile(&body, [-w, w]);
    van.block([r - 0.09, -w + 0.05, 0.36], [r + 0.05, w - 0.05, 0.52]);
    // Roof bars, door rails, rear door hinges, mirrors.
    for x in [-0.35, 0.25] {
        van.block([x * f, -w + 0.05, top + 0.04], [x * f + 0.06, w - 0.05, top + 0.08]);
        for y in [-w + 0.1, w - 0.1] {
            van.tube([x * f + 0.03, y, top - 0.05], [x * f + 0.03, y, top + 0.06], 0.02);
        }
    }
    for side in [-1.0, 1.0] {
        let (inner, outer) = (side * (w - 0.05), side * (w + 0.02));
        van.block([r + 0.3, inner.min(outer), 1.05], [f - 1.6, inner.max(outer), 1.1]);
        van.ball([f - 1.0, side * (w + 0.1), 1.28], [0.07, 0.14, 0.14]);
    }
    wheels(&mut van, &[0.64 * f, -0.6 * f], w, 0.34);
    van
}

fn wheels(vehicle: &mut Parts, axles: &[f64], half_width: f64, radius: f64) {
    for &x in axles {
        for side in [-1.0, 1.0] {
            let at = |y: f64| [x, side * y, radius - 0.02];
            vehicle.material(RUBBER);
            vehicle.tube(at(half_width - 0.2), at(half_width + 0.01), radius);
            vehicle.material(0.5);
            vehicle.cone(
                at(half_width - 0.1),
                at(half_width + 0.025),
                0.65 * radius,
                0.5 * radius,
            );
        }
    }
}

/// A forklift truck.
pub(crate) fn forklift() -> Parts {
    let mut truck = Parts::of(0.45);
    truck.profile(
        &[
            [-1.05, 0.3],
            [-0.9, 0.14],
            [0.9, 0.14],
            [0.9, 0.55],
            [0.15, 0.6],
            [0.1, 0.95],
            [-0.85, 1.05],
            [-1.05, 0.8],
        ],
        [-0.52, 0.52],
    );
    truck.block([-0.55, -0.25, 0.9], [-0.1, 0.25, 1.15]);
    truck.block([-0.6, -0.25, 1.0], [-0.48, 0.25, 1.55]);
    truck.tube([0.35, 0.0, 0.5], [0.2, 0.0, 1.2], 0.025);
    truck.add(crate::Primitive::frustum(0.17, 0.17, 0.03).placed(&tsdfuse::Pose {
        rotation: glam::DQuat::from_rotation_y(-0.2),
        translation: glam::DVec3::new(0.2, 0.0, 1.19),
    }));
    // Overhead guard, mast, carriage and forks.
    for y in [-0.45, 0.45] {
        truck.tube([0.75, y, 0.5], [0.35, y, 2.1], 0.03);
        truck.tube([-0.8, y, 0.95], [-0.6, y, 2.1], 0.03);
        truck.block([-0.65, y - 0.03, 2.07], [0.45, y + 0.03, 2.12]);
        truck.block([0.9, 0.6 * y - 0.05, 0.05], [1.05, 0.6 * y + 0.05, 2.3]);
        truck.block([1.0, 0.6 * y - 0.06, 0.06], [2.1, 0.6 * y + 0.06, 0.1]);
        truck.block([1.04, 0.6 * y - 0.06, 0.06], [1.1, 0.6 * y + 0.06, 0.7]);
    }
    for i in 0..6 {
        let x = -0.63 + 0.2 * f64::from(i);
        truck.block([x, -0.5, 2.08], [x + 0.05, 0.5, 2.13]);
    }
    for z in [0.6, 1.4, 2.25] {
        truck.block([0.92, -0.33, z], [1.03, 0.33, z + 0.06]);
    }
    wheels(&mut truck, &[0.6, -0.7], 0.5, 0.25);
    truck
}
