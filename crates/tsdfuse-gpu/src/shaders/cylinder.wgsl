// Cylinders about lines: see `tsdfuse::fuse::lines::Shape`.

// How far from the centre their voxels may be, along the line's dominant axis.
fn reach_along(l: Line, axis_m: f32) -> f32 {
    return SLACK + abs(axis_m) * l.reach + sqrt(max(1.0 - axis_m * axis_m, 0.0)) * VOXEL_RADIUS;
}

// How many voxels there may be side by side, along the second of three axes.
fn wide(axis: vec3<f32>) -> f32 {
    return select(3.0, 2.0, 0.75 * (1.0 - axis.z * axis.z) < (1.0 - 2.0 * SLACK) * axis.x * axis.x);
}
