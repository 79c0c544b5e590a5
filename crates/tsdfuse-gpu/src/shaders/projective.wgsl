// The related work's form of raycasting: see `tsdfuse::fuse::raycast::Projective`.

// An axis along which the line moves slower than this counts as standing still.
const STILL: f32 = 1e-6;

fn reach_along(l: Line, axis_m: f32) -> f32 {
    let across = sqrt(max(1.0 - axis_m * axis_m, 0.0));
    return SLACK + min(abs(axis_m) * l.reach + across * VOXEL_RADIUS, l.reach);
}

fn wide(axis: vec3<f32>) -> f32 {
    return select(3.0, 2.0, abs(axis.y) < (1.0 - 2.0 * SLACK) * abs(axis.x));
}

// Whether a line passes through a voxel: seen along each edge of the voxel, the line must cross the square that the voxel covers.
fn pierced(axis: vec3<f32>, offset: vec3<f32>) -> bool {
    let off = offset.yzx * axis.zxy - offset.zxy * axis.yzx;
    let half = max(0.5 * (abs(axis.yzx) + abs(axis.zxy)), vec3(STILL));
    return all(off > -half) && all(off <= half);
}

// The distance divided by μ, and the weight; a weight of 0 means no update.
fn rule(l: Line, v: Near) -> vec2<f32> {
    let truncation = frame.truncation_vox;
    let inside = pierced(l.axis, v.offset) && v.distance2 <= truncation * truncation;
    let slope = 1.0 / (truncation - min(0.5 * truncation, 1.5));
    let beside = 1.0 - (v.distance2 - v.along * v.along) / (VOXEL_RADIUS * VOXEL_RADIUS);
    let behind = clamp((truncation - v.along) * slope, 0.0, 1.0);
    return vec2(-v.along / truncation, select(0.0, beside * l.weight * (behind * behind), inside));
}
