// Cylinders about lines: see `tsdfuse::fuse::lines::Shape`.

// The largest distance of their voxels from the centre, along the line's dominant axis.
fn reach_along(l: Line, axis_m: f32) -> f32 {
    return SLACK + abs(axis_m) * l.reach + sqrt(max(1.0 - axis_m * axis_m, 0.0)) * VOXEL_RADIUS;
}

// The largest number of voxels side by side, along the second of three axes.
fn wide(axis: vec3<f32>) -> f32 {
    return select(3.0, 2.0, 0.75 * (1.0 - axis.z * axis.z) < (1.0 - 2.0 * SLACK) * axis.x * axis.x);
}
