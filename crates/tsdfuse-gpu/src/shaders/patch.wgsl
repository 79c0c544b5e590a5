// Surface patches: lines along the normals of planes, between neighbours of one surface, and along rays. See `tsdfuse::fuse::patch`
// and `tsdfuse::patch::between`.

// Three threads per return: for the return itself, for the link to the next ring, and for the link to the next column.
fn fuse_return(i: u32, thread: u32) -> u32 {
    let cell = cell_of(i);
    let has_plane = cell != NONE && is_plane(patches[cell]);
    if thread == 0u && !has_plane {
        return fuse_ray(i);
    } else if thread == 0u && (patches[cell].turn & WAITS) != 0u {
        return FUSED;
    } else if thread == 0u {
        return fuse_patch(patches[cell]);
    } else if cell != NONE {
        let ring = cell / frame.columns;
        let column = cell % frame.columns;
        if thread == 2u {
            connect(cell, next_in_row(ring, column), MAX_GAP_ACROSS_M, CONTRADICTED_IN_ROW);
        } else if column % nth(frame.step_m / (frame.column_rad * length(patches[cell].center))) == 0u {
            connect(cell, next_in_column(ring, column), 1e30, CONTRADICTED_IN_COLUMN);
        }
    }
    return NO_RETURN;
}

// The cells of neighbours: NONE, if there is no return near enough.
fn next_in_row(ring: u32, column: u32) -> u32 {
    for (var k = 1u; k <= frame.neighbour_cells; k++) {
        let near = ring * frame.columns + (column + k) % frame.columns;
        if patches[near].kind != NOWHERE {
            return near;
        }
    }
    return NONE;
}

fn next_in_column(ring: u32, column: u32) -> u32 {
    for (var k = 1u; k <= min(frame.neighbour_cells, frame.rings - 1u - ring); k++) {
        let near = (ring + k) * frame.columns + column;
        if patches[near].kind != NOWHERE {
            return near;
        }
    }
    return NONE;
}

// How far in front of it a patch is fused, in voxels.
fn front() -> f32 {
    return min(FRONT, frame.truncation_vox);
}

// Where a patch lies in the grid, in voxels from the anchor's; the second part is false if it is outside.
struct Center {
    at: vec3<f32>,
    is_there: bool,
}

fn center_of_patch(surface: Patch) -> Center {
    let at = frame.anchor_fraction + surface.center * frame.voxels_per_m;
    return Center(at, all(abs(at) < vec3(MAX_REACH)));
}

fn fuse_patch(surface: Patch) -> u32 {
    let center = center_of_patch(surface);
    if !center.is_there {
        return OUTSIDE_GRID;
    }
    let range_m = max(length(surface.center), 1e-30);
    let cosine = cosine_of(surface);
    let sigma = sigma_vox(arm_m(surface));
    // Those of one scan that meet in one voxel are off together.
    let crowd = max(frame.crowd * cosine / (range_m * range_m), 1.0);
    let off = sigma * (1.0 / HALVING);
    let share = 1.0 / (1.0 + crowd * off * off);
    var l = line(center.at, surface.normal, share * weight_of(surface) * f32(surface.turn & TIMES));
    l.reach = clamp(SIGMAS * sigma, front(), frame.truncation_vox);
    walk(l);
    return FUSED;
}

// The cosine of the angle at which the sensor sees a patch; where there is no plane, it faces the sensor.
fn cosine_of(surface: Patch) -> f32 {
    return max(-dot(surface.center, surface.normal) / max(length(surface.center), 1e-30), 0.0);
}

// What a patch weighs where scans agree.
fn weight_of(surface: Patch) -> f32 {
    let known = select(RAY_WEIGHT, 1.0, is_plane(surface));
    return known * cosine_of(surface) * min(1.0 / max(length(surface.center), 1e-30), 1.0);
}

// A return without a plane.
fn fuse_ray(i: u32) -> u32 {
    let ray = ray_of(i);
    if ray.outcome == FUSED {
        var l = line(ray.end, -ray.direction, RAY_WEIGHT * min(1.0 / ray.range_m, 1.0));
        l.reach = front();
        walk(l);
    }
    return ray.outcome;
}

// The largest power of two up to a number; at least 1.
fn nth(dense: f32) -> u32 {
    return 1u << firstLeadingBit(max(u32(dense), 1u));
}

// What is known between two neighbours: NOWHERE, if nothing tells that they are of one surface, or if they are too far apart.
struct Link {
    kind: u32,
    is_wide: bool,
}

fn linked(a: Patch, b: Patch, longest_m: f32) -> Link {
    let apart = b.center - a.center;
    let gap = length(apart);
    let range = min(length(a.center), length(b.center));
    let growing = frame.max_gap_m * (range / FAR_M);
    let widest = max(growing, frame.max_gap_m);
    let kind = min(a.kind, b.kind);
    // Without a plane the normal is zero, and so is this.
    let off = max(abs(dot(a.normal, apart)), abs(dot(b.normal, apart)));
    var is_wide = false;
    var is_one = gap <= widest && off <= frame.window_m && abs(length(b.center) - length(a.center)) <= MIN_DOT * gap;
    if kind > RAY {
        // A plane through half of a window is known as far as the window reaches; a plane through a whole one, as far as the sensor sees it.
        let middle = a.center + b.center;
        let seen = apart - middle * (dot(apart, middle) / max(dot(middle, middle), 1e-30));
        let far = select(min(max(growing, 2.0 * frame.window_m), widest), widest, kind == WHOLE);
        is_one = select(gap, length(seen), kind == WHOLE) <= far
            && off <= MAX_OFF_BETWEEN * noise_m() && dot(a.normal, b.normal) >= MIN_DOT;
        // Two whole ones that agree certify what lies between.
        is_wide = kind == WHOLE && length(seen) > widest;
        is_one = is_one || (kind == WHOLE && length(seen) <= COPLANAR_GAPS * widest && gap <= COPLANAR_LENGTH_M
            && off <= COPLANAR_OFF_M && dot(a.normal, b.normal) >= COPLANAR_DOT);
    }
    if gap < frame.step_m || gap > min(longest_m, MAX_GAP_OF_RANGE * range) || !is_one {
        return Link(NOWHERE, false);
    }
    return Link(kind, is_wide);
}

// How many steps there are from one to the other.
fn steps_between(a: Patch, b: Patch) -> f32 {
    return ceil(length(b.center - a.center) / frame.step_m);
}

// The patch between two that is this part of the way on.
fn between(a: Patch, b: Patch, kind: u32, t: f32) -> Patch {
    let center = a.center + (b.center - a.center) * t;
    let normal = select(a.normal + (b.normal - a.normal) * t, -center, kind == RAY);
    return Patch(center, kind, normal / max(length(normal), 1e-30), 1u);
}

// Fuses the surface between a cell and a neighbour, if both lie on the same one and are no farther apart than this, unless it is free.
fn connect(cell: u32, near: u32, longest_m: f32, free: u32) {
    if near == NONE || (patches[cell].turn & free) != 0u {
        return;
    }
    let a = patches[cell];
    let b = patches[near];
    // The end that takes part more often, since it is less known, tells when.
    let turn = select(a.turn, b.turn, (b.turn & TIMES) < (a.turn & TIMES));
    if (turn & WAITS) != 0u {
        return;
    }
    let link = linked(a, b, longest_m);
    if link.kind == NOWHERE {
        return;
    }
    let steps = steps_between(a, b);
    for (var k = 1.0; k < steps; k += 1.0) {
        var surface = between(a, b, link.kind, k / steps);
        surface.turn = turn;
        fuse_patch(surface);
    }
}

// The distance divided by μ, and the weight, which falls behind the surface; a weight of 0 means no update.
fn rule(l: Line, v: Near) -> vec2<f32> {
    let behind = l.reach * (BEHIND / FRONT);
    let full = l.reach * (FULL_BEHIND / FRONT);
    let known = clamp((v.along + behind + 0.5) / (behind + 0.5 - full), 0.0, 1.0);
    let inside = v.distance2 - v.along * v.along <= VOXEL_RADIUS * VOXEL_RADIUS && v.along <= l.reach && v.along >= -behind;
    return vec2(v.along / frame.truncation_vox, select(0.0, known * l.weight, inside));
}
