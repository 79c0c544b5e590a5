// Free space: where rays pass through, there is no surface. See `tsdfuse::fuse::carve`.

// The bin of elevation and the column in which the sensor sees a place (sensor's axes).
fn seen_at(p: vec3<f32>) -> vec2<u32> {
    let elevation = arc_tangent2(p.z, sqrt(p.x * p.x + p.y * p.y));
    let columns = f32(frame.columns);
    let column = -arc_tangent2(p.y, p.x) * (columns / (2.0 * PI));
    let place = vec2((elevation + 0.5 * PI) * BINS_PER_RAD + 0.5, select(column, column + columns, column < 0.0));
    return vec2<u32>(max(place, vec2(0.0)));
}

// The cell of the ring nearest to a bin of elevation.
fn cell_at(bin: u32, column: u32) -> u32 {
    let last = u32(PI * BINS_PER_RAD);
    return returns[frame.nearest_at + min(bin, last)] * frame.columns + column % frame.columns;
}

// A place (world axes, relative to the anchor, metres) in the sensor frame some seconds after the scan's pose.
fn to_sensor_after(place: vec3<f32>, secs: f32) -> vec3<f32> {
    if frame.times_at == 0u {
        return to_sensor(place);
    }
    let segment = segment_at(secs);
    return from_first_axes(to_sensor(place - shift_at(segment, secs)), segment, secs);
}

// The first return in the column in which a place is seen from the scan's pose: the sensor faced the place at that return's time.
fn first_towards(place: vec3<f32>) -> Cell {
    let column = seen_at(to_sensor(place)).y % frame.columns;
    var cell = cells[column];
    for (var ring = 1u; ring < frame.rings && cell.i == NONE; ring++) {
        cell = cells[ring * frame.columns + column];
    }
    return cell;
}

// A block as the sensor sees it at the moment when it faces the block.
struct Look {
    // Whether the ray nearest to the block's centre ends behind the block.
    may_be_passed: bool,
    // That moment, seconds after the scan's pose.
    secs: f32,
}

fn look_at(corner_vox: vec3<f32>, voxel_size_m: f32) -> Look {
    let middle = (corner_vox + 4.0) * voxel_size_m;
    var secs = 0.0;
    if frame.times_at != 0u {
        let first = first_towards(middle);
        if !is_there(first) {
            return Look(false, 0.0);
        }
        secs = time_of(first.i);
    }
    let p = to_sensor_after(middle, secs);
    let at = seen_at(p);
    let cell = cells[cell_at(at.x, at.y)];
    let far_m = length(p) + BLOCK_RADIUS * voxel_size_m;
    return Look(is_there(cell) && length(cell.point - origin_of(cell)) > far_m, secs);
}

// F at a voxel of a block, and 1 if the voxel is inside the block and was observed.
fn distance_at(slot: u32, at: vec3<i32>) -> vec2<f32> {
    if any(at < vec3(0)) || any(at > vec3(7)) {
        return vec2(0.0);
    }
    let voxel = load_voxel(slot, u32(at.x + 8 * at.y + 64 * at.z));
    return vec2(f32(bitcast<i32>(voxel.y)) / f32(max(voxel.x, 1u)), f32(voxel.x > 0u));
}

// The growth of F along an axis: the sum of two differences, or twice the only one.
fn slope(slot: u32, at: vec3<i32>, step: vec3<i32>) -> f32 {
    let here = distance_at(slot, at).x;
    let before = distance_at(slot, at - step);
    let after = distance_at(slot, at + step);
    let both = select(2.0, 1.0, before.y * after.y == 1.0);
    return both * ((here - before.x) * before.y + (after.x - here) * after.y);
}

// The direction in which F grows at a voxel, from differences to its observed neighbours in the same block.
fn gradient_at(slot: u32, at: vec3<i32>) -> vec3<f32> {
    return vec3(slope(slot, at, vec3(1, 0, 0)), slope(slot, at, vec3(0, 1, 0)), slope(slot, at, vec3(0, 0, 1)));
}

// What is left of a ray from a place to its end, and how far behind a surface it must end; zero if there is none.
struct Rest {
    way: vec3<f32>,
    least_m: f32,
}

// The ray that passes a place and ends well behind it, seen from the sensor some seconds after the scan's pose.
fn ray_past(center: vec3<f32>, secs: f32, voxel_size_m: f32) -> Rest {
    let at = seen_at(to_sensor_after(center, secs));
    for (var next = 0u; next < 2u; next++) {
        let number = cell_at(at.x, at.y + next);
        let cell = cells[number];
        if !is_there(cell) {
            continue;
        }
        let origin = origin_of(cell);
        let end = cell.point - origin;
        let p = center - origin;
        let size = length(end);
        let along = dot(p, end) / size;
        let above = select(size - along, dot(p - end, patches[number].normal), is_plane(patches[number]));
        // The length of one vector: a difference of squares would cancel.
        let beside = p - end * (along / size);
        let arm = select(size, arm_m(patches[number]), is_plane(patches[number]));
        let margin_m = (MARGIN + SIGMAS_OF_RAYS * sigma_vox(arm)) * voxel_size_m;
        let radius_m = BESIDE * voxel_size_m;
        if along > 0.0 && size - along > margin_m && above > margin_m && dot(beside, beside) < radius_m * radius_m {
            return Rest(end - p, margin_m);
        }
    }
    return Rest(vec3(0.0), 0.0);
}

// A fraction of both sums, or nothing if the rest is negligible.
fn fade(voxel: vec2<u32>) -> vec2<u32> {
    let weight = voxel.x / u32(LEFT);
    return select(vec2(weight, bitcast<u32>(bitcast<i32>(voxel.y) / LEFT)), vec2(0u), weight < FORGOTTEN);
}

var<workgroup> count: u32;
var<workgroup> passed: atomic<u32>;
var<workgroup> look: Look;

// Fades what rays contradict, after all updates. Workgroups loop over blocks. In a block that the scan updated, the voxels that rays
// pass fade; in any other block all voxels fade if rays pass enough of them.
@compute @workgroup_size(64)
fn carve(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        count = select(0u, min(atomicLoad(&state.blocks), state.capacity), atomicLoad(&state.flags) == 0u);
    }
    let blocks_there = workgroupUniformLoad(&count);
    let voxel_size_m = 1.0 / frame.voxels_per_m;
    let inside = INSIDE / frame.truncation_vox;
    for (var slot = group.x; slot < blocks_there; slot += groups.x) {
        let index = blocks[slot].index;
        let is_updated = atomicLoad(&blocks[slot].stamp) == frame.stamp;
        let number = u32(index.x + index.y + index.z) + frame.stamp;
        let in_turn = number % select(TURNS, TURNS_UPDATED, is_updated) == 0u;
        let corner = corner_of(index);
        if lane == 0u {
            atomicStore(&passed, 0u);
            if in_turn {
                look = look_at(corner, voxel_size_m);
            }
        }
        workgroupBarrier();
        // One bit for each voxel of this thread.
        var here = 0u;
        if in_turn && look.may_be_passed {
            for (var k = 0u; k < 8u; k++) {
                let voxel = load_voxel(slot, lane + 64u * k);
                // False where nothing was observed.
                if f32(bitcast<i32>(voxel.y)) < -inside * f32(voxel.x) {
                    let at = vec3(lane & 7u, lane >> 3u, k);
                    let rest = ray_past((corner + vec3<f32>(at) + 0.5) * voxel_size_m, look.secs, voxel_size_m);
                    if any(rest.way != vec3(0.0)) {
                        let gradient = gradient_at(slot, vec3<i32>(at));
                        here |= u32(-dot(gradient, rest.way) >= rest.least_m * length(gradient)) << k;
                    }
                }
            }
            atomicAdd(&passed, countOneBits(here));
        }
        workgroupBarrier();
        let is_doubted = !is_updated && atomicLoad(&passed) >= MIN_PASSED;
        let changed = select(select(0u, 255u, is_doubted), here, is_updated);
        for (var k = 0u; k < 8u; k++) {
            if (changed >> k & 1u) == 1u {
                let local = lane + 64u * k;
                store_voxel(slot, local, fade(load_voxel(slot, local)));
            }
        }
        if is_doubted && lane == 0u {
            list_update(slot);
        }
        workgroupBarrier();
    }
}
