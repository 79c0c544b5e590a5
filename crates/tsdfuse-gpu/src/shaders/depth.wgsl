// Depth images. Pixels are those of `tsdfuse::sensor::DepthImage`, blocks and voxels those of `tsdfuse::fuse::depth`. Depths are measured
// along the optical axis; after them, `pixels` holds the largest one.

// An axis along which a line moves slower than this counts as standing still.
const STILL: f32 = 1e-9;

// The pixel in which a point of the camera's frame is seen, or NONE.
fn pixel_of(p: vec3<f32>) -> u32 {
    let seen = frame.camera.zw - frame.camera.xy * p.yz * (1.0 / p.x) + 0.5;
    let inside = p.x > 0.0 && all(seen >= vec2(0.0)) && seen.x < f32(frame.columns) && seen.y < f32(frame.rings);
    return select(NONE, u32(seen.x) + u32(seen.y) * frame.columns, inside);
}

var<workgroup> farthest: atomic<u32>;

// Finds the depth of each pixel.
@compute @workgroup_size(64)
fn find_depths(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        let p = point_of(i);
        let pixel = select(NONE, pixel_of(p), is_finite(bitcast<vec3<u32>>(p)));
        offer(pixel, p.x);
        if pixel != NONE {
            atomicMax(&farthest, bitcast<u32>(p.x));
        }
    }
    tell_offers(lane);
    if lane == 0u {
        atomicMax(&pixels[pixel_count()], atomicLoad(&farthest));
    }
}

// The depth of a pixel, metres; 0 where nothing was measured.
fn depth_in(pixel: u32) -> f32 {
    let bits = depth_bits(pixel);
    return bitcast<f32>(select(bits, 0u, bits == NONE));
}

// The point at depth 1 that is seen at a column and a row (camera's axes).
fn ray_through(u: f32, v: f32) -> vec3<f32> {
    return vec3(1.0, (frame.camera.z - u) / frame.camera.x, (frame.camera.w - v) / frame.camera.y);
}

// Creates the blocks between two places, in voxels relative to the anchor's.
fn allocate_between(from_vox: vec3<f32>, to_vox: vec3<f32>) {
    let home = frame.anchor_voxel >> vec3(3u);
    let shift = vec3<f32>(frame.anchor_voxel & vec3(7));
    let a = (shift + from_vox) / 8.0;
    let d = (shift + to_vox) / 8.0 - a;
    var cell = floor(a);
    let last = floor(a + d);
    let steps = abs(last - cell);
    let up = d >= vec3(0.0);
    let inverse = 1.0 / max(abs(d), vec3(STILL));
    var next = select(a - cell, cell + 1.0 - a, up) * inverse;
    allocate(home + vec3<i32>(cell));
    for (var left = steps.x + steps.y + steps.z; left > 0.0; left -= 1.0) {
        let open = select(vec3(1e30), next, cell != last);
        let now = min(open.x, min(open.y, open.z));
        // One axis at a time, so that no block is skipped.
        let axis = select(select(2u, 1u, open.y == now), 0u, open.x == now);
        cell[axis] += select(-1.0, 1.0, up[axis]);
        next[axis] += inverse[axis];
        allocate(home + vec3<i32>(cell));
    }
}

var<workgroup> outcomes: array<atomic<u32>, 2>;

// Creates the blocks on the line of sight of each pixel, from μ in front of its depth to μ behind it.
@compute @workgroup_size(64)
fn allocate_depth(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if atomicLoad(&state.flags) == 0u && id.x < frame.count {
        let pixel = frame.first + id.x;
        let depth = depth_in(pixel);
        if depth > 0.0 {
            let seen = ray_through(f32(pixel % frame.columns), f32(pixel / frame.columns));
            let r = frame.world_x * seen.x + frame.world_y * seen.y + frame.world_z * seen.z;
            let truncation_m = frame.truncation_vox / frame.voxels_per_m;
            let near = frame.anchor_fraction + r * ((depth - truncation_m) * frame.voxels_per_m);
            let far = frame.anchor_fraction + r * ((depth + truncation_m) * frame.voxels_per_m);
            // All of it must lie within the grid.
            let inside = all(abs(near) < vec3(MAX_REACH)) && all(abs(far) < vec3(MAX_REACH));
            if inside {
                allocate_between(near, far);
            }
            atomicAdd(&outcomes[select(1u, 0u, inside)], 1u);
        }
    }
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&state.fused, atomicLoad(&outcomes[0]));
        atomicAdd(&state.outside_grid, atomicLoad(&outcomes[1]));
    }
}

// Whether part of a ball is on the inner side of the image's border between two of its corners.
fn within(corner: vec3<f32>, next: vec3<f32>, center: vec3<f32>, radius: f32) -> bool {
    return dot(normalize(cross(next, corner)), center) >= -radius;
}

// Whether part of a ball can be seen.
fn sees(center: vec3<f32>, radius: f32, truncation_m: f32) -> bool {
    let right = f32(frame.columns) - 0.5;
    let bottom = f32(frame.rings) - 0.5;
    let a = ray_through(-0.5, -0.5);
    let b = ray_through(-0.5, bottom);
    let c = ray_through(right, bottom);
    let d = ray_through(right, -0.5);
    let reach_m = bitcast<f32>(atomicLoad(&pixels[pixel_count()]));
    return center.x <= reach_m + truncation_m + radius && within(a, b, center, radius)
        && within(b, c, center, radius) && within(c, d, center, radius) && within(d, a, center, radius);
}

// Updates all voxels of the blocks in view. Workgroups loop over blocks.
@compute @workgroup_size(64)
fn fuse_depth(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if atomicLoad(&state.flags) != 0u {
        return;
    }
    let voxel_size_m = 1.0 / frame.voxels_per_m;
    let truncation_m = frame.truncation_vox * voxel_size_m;
    let count = min(atomicLoad(&state.blocks), state.capacity);
    for (var slot = group.x; slot < count; slot += groups.x) {
        let first = corner_of(blocks[slot].index);
        if !sees(to_sensor((first + 4.0) * voxel_size_m), BLOCK_RADIUS * voxel_size_m, truncation_m) {
            continue;
        }
        var updated = false;
        var is_heavy = false;
        for (var local = lane; local < BLOCK_VOXELS; local += 64u) {
            let at = vec3<f32>(vec3(local & 7u, local >> 3u & 7u, local >> 6u));
            let x = to_sensor((first + at + 0.5) * voxel_size_m);
            let pixel = pixel_of(x);
            if pixel == NONE {
                continue;
            }
            let depth = depth_in(pixel);
            let eta = depth - x.x; // (5.2)
            if depth > 0.0 && eta >= -truncation_m {
                let distance = round(clamp(eta / truncation_m, -1.0, 1.0) * WEIGHT_SCALE); // (5.3)
                let before = add_to_voxel(slot, local, u32(WEIGHT_SCALE), bitcast<u32>(i32(distance)));
                is_heavy = is_heavy || before > frame.heavy_sum;
                updated = true;
            }
        }
        if is_heavy {
            atomicOr(&state.heavy, 1u);
        }
        if updated {
            note_update(slot);
        }
    }
}
