// Cylindrical depth images: see `tsdfuse::sensor::Cylindrical`, whose pixels these are, and `tsdfuse::fuse::Cylindrical`.
// After the depths, `pixels` holds the return of each pixel, bits flipped.

// The pixel of a return.
struct Seen {
    // Distance from the axis, metres.
    depth: f32,
    // Or NONE.
    pixel: u32,
}

@group(1) @binding(3) var<storage, read_write> seen: array<Seen>;

var<workgroup> bins: array<atomic<u32>, PHASE_BINS>;

// Counts returns by their place within a column, …
@compute @workgroup_size(64)
fn count_parts(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        let p = point_of(i);
        if is_finite(bitcast<vec3<u32>>(vec3(p.xy, 0.0))) {
            let column = -arc_tangent2(p.y, p.x) * frame.columns_per_rad;
            atomicAdd(&bins[bin_of(column - floor(column))], 1u);
        }
    }
    workgroupBarrier();
    if lane < PHASE_BINS && atomicLoad(&bins[lane]) != 0u {
        atomicAdd(&rings[0].bins[lane], atomicLoad(&bins[lane]));
    }
}

// … as if all belonged to one ring.
@compute @workgroup_size(64)
fn find_phase(@builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        rings[0].phase = mean_phase(0u);
    }
}

fn see(p: vec3<f32>) -> Seen {
    let nowhere = Seen(0.0, NONE);
    let depth = sqrt(p.x * p.x + p.y * p.y);
    if !(is_finite(bitcast<vec3<u32>>(p)) && is_finite(vec3(bitcast<u32>(depth))) && depth > 0.0) {
        return nowhere;
    }
    let columns = f32(frame.columns);
    var column = -arc_tangent2(p.y, p.x) * frame.per_pitch - rings[0].phase;
    column += select(0.0, columns, column < -0.5);
    column -= select(0.0, columns, column >= columns - 0.5);
    let row = (frame.top - p.z / depth) * frame.per_pitch + 0.5;
    if !(row >= 0.0 && row < f32(frame.rings)) {
        return nowhere;
    }
    return Seen(depth, u32(row) * frame.columns + min(u32(column + 0.5), frame.columns - 1u));
}

// Each pixel goes to its nearest return, …
@compute @workgroup_size(64)
fn offer_pixels(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        let s = see(point_of(i));
        seen[i] = s;
        offer(s.pixel, s.depth);
    }
    tell_offers(lane);
}

// … or to the first of several.
@compute @workgroup_size(64)
fn choose_nearest(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        let s = seen[i];
        if s.pixel != NONE && depth_bits(s.pixel) == bitcast<u32>(s.depth) {
            atomicMax(&pixels[pixel_count() + s.pixel], ~i);
        }
    }
}

// The point (sensor frame) at the centre of a return's pixel, at the return's depth (5.28)–(5.31).
fn centre_of(s: Seen) -> vec3<f32> {
    let at = frame.towards_at + 2u * (s.pixel % frame.columns);
    let column = bitcast<vec2<f32>>(vec2(returns[at], returns[at + 1u]));
    let turn = sin_cos(-frame.column_rad * rings[0].phase);
    let towards = column * turn.y + vec2(-column.y, column.x) * turn.x;
    return vec3(towards, frame.top - f32(s.pixel / frame.columns) * frame.column_rad) * s.depth;
}

// The line along the ray to that point.
fn line_of(i: u32) -> Line {
    let s = seen[i];
    if s.pixel == NONE || atomicLoad(&pixels[pixel_count() + s.pixel]) != ~i {
        return no_line(NO_RETURN);
    }
    return line_along(ray_to(i, centre_of(s)));
}
