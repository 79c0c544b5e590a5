// The thesis's form of raycasting: see `tsdfuse::fuse::raycast::Euclidean`.

fn reach_along(l: Line, axis_m: f32) -> f32 {
    let across = sqrt(max(1.0 - axis_m * axis_m, 0.0));
    return SLACK + min(abs(axis_m) * l.reach + across * VOXEL_RADIUS, l.reach);
}

fn wide(axis: vec3<f32>) -> f32 {
    return select(3.0, 2.0, 0.75 * (1.0 - axis.z * axis.z) < (1.0 - 2.0 * SLACK) * axis.x * axis.x);
}

// The distance divided by μ, and the weight; a weight of 0 means no update.
fn rule(l: Line, v: Near) -> vec2<f32> {
    let truncation = frame.truncation_vox;
    let inside = v.distance2 - v.along * v.along <= VOXEL_RADIUS * VOXEL_RADIUS && v.distance2 <= truncation * truncation;
    let distance = sqrt(v.distance2) / truncation; // (5.7)
    return vec2(select(distance, -distance, v.along >= 0.0), select(0.0, l.weight, inside));
}
