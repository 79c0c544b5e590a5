// How often the map listens where it knows the surface: see `tsdfuse::fuse::settled`.

// In one of how many scans a patch takes part.
fn times_of(surface: Patch, voxel: vec2<u32>) -> u32 {
    let range_m = max(length(surface.center), 1e-30);
    let weight = max(weight_of(surface), 1e-30);
    let lines = max(frame.crowd * cosine_of(surface) / (range_m * range_m), LEAST_LINES);
    let held = f32(voxel.x);
    let scans = held / (KNOWN * WEIGHT_SCALE * weight * lines);
    let is_other = frame.truncation_vox * abs(f32(bitcast<i32>(voxel.y))) > OTHER_SURFACE * held;
    // No update weighs more than 1.
    let most = u32(clamp(min(scans, 1.0 / weight), 1.0, f32(MOST_TIMES)));
    return select(1u << firstLeadingBit(most), 1u, is_other);
}

// The voxel of the grid that a patch lies in.
fn voxel_of(center: Center) -> vec3<i32> {
    return frame.anchor_voxel + vec3<i32>(floor(center.at));
}

// When a patch takes part: TIMES and WAITS.
fn turn_of(surface: Patch) -> u32 {
    let center = center_of_patch(surface);
    if !is_plane(surface) || sigma_vox(arm_m(surface)) > AGREES || !center.is_there {
        return 1u;
    }
    let voxel = voxel_of(center);
    let block = voxel >> vec3(3u);
    let slot = slot_of(block);
    if slot == NONE {
        return 1u;
    }
    let at = vec3<u32>(voxel & vec3(7));
    let times = times_of(surface, load_voxel(slot, at.x | at.y << 3u | at.z << 6u));
    let is_due = ((u32(block.x + block.y + block.z) + frame.stamp) & (times - 1u)) == 0u;
    return select(times | WAITS, times, is_due);
}

// Whether the link from a patch to that of another cell is wide and contradicted by what the map holds.
fn is_contradicted_link(a: Patch, near: u32, longest_m: f32) -> bool {
    if near == NONE {
        return false;
    }
    // Turns are being written.
    let b = Patch(patches[near].center, patches[near].kind, patches[near].normal, 1u);
    if !linked(a, b, longest_m).is_wide {
        return false;
    }
    let steps = steps_between(a, b);
    for (var k = 1.0; k < steps; k += 1.0) {
        let surface = between(a, b, WHOLE, k / steps);
        let center = center_of_patch(surface);
        if center.is_there && is_contradicted(center.at, surface.normal) {
            return true;
        }
    }
    return false;
}

@compute @workgroup_size(64)
fn find_turns(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var cell = id.x; cell < frame.rings * frame.columns; cell += 64u * groups.x) {
        let surface = patches[cell];
        var turn = turn_of(surface);
        if surface.kind == WHOLE {
            let ring = cell / frame.columns;
            let column = cell % frame.columns;
            turn |= select(0u, CONTRADICTED_IN_COLUMN, is_contradicted_link(surface, next_in_column(ring, column), 1e30));
            turn |= select(0u, CONTRADICTED_IN_ROW, is_contradicted_link(surface, next_in_row(ring, column), MAX_GAP_ACROSS_M));
        }
        patches[cell].turn = turn;
    }
}

// Counts the blocks that wait among those that the scan updated, after it is fused: it shows that their surface is there.
@compute @workgroup_size(64)
fn mark_waiting(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    // A scan that found no room is repeated, and lists then what it updates.
    if atomicLoad(&state.flags) != 0u {
        return;
    }
    for (var cell = id.x; cell < frame.rings * frame.columns; cell += 64u * groups.x) {
        if patches[cell].kind != NOWHERE && (patches[cell].turn & WAITS) != 0u {
            let slot = slot_of(voxel_of(center_of_patch(patches[cell])) >> vec3(3u));
            if slot != NONE {
                atomicStore(&blocks[slot].stamp, frame.stamp);
            }
        }
    }
}
