//! The simplest scenes, for tests.

use glam::{DQuat, DVec3, EulerRot};
use tsdfuse::Pose;

use crate::primitive::Primitive;

pub(super) fn plane() -> Vec<Primitive> {
    let slab = DVec3::new(100.0, 100.0, 20.0);
    vec![Primitive::cuboid(slab).at(0.0, 0.0, -slab.z / 2.0)]
}

pub(super) fn sphere() -> Vec<Primitive> {
    vec![Primitive::ellipsoid(DVec3::splat(2.0))]
}

pub(super) fn cuboid() -> Vec<Primitive> {
    let turned = Pose {
        rotation: DQuat::from_euler(EulerRot::ZYX, 0.5, 0.3, 0.2),
        ..Pose::IDENTITY
    };
    vec![Primitive::cuboid(DVec3::new(3.0, 2.0, 1.5)).placed(&turned)]
}
