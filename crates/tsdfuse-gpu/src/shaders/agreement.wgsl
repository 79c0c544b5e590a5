// How well a scan agrees with the surface that the map holds: see `tsdfuse::fuse::agreement`.

// The arm of a turn of the sensor: how far a patch moves along its normal, at most, for each radian.
fn arm_m(surface: Patch) -> f32 {
    return length(cross(surface.center, surface.normal));
}

// The logarithm to base 2 of an arm, from 0 on, by straight lines between whole numbers.
fn place_of_arm(arm: f32) -> f32 {
    let log2 = f32(bitcast<u32>(max(arm, 1.0))) / 8388608.0 - 127.0;
    return clamp(log2, 0.0, f32(ARMS) - 0.5);
}

// The standard deviation of planes with some arm from the surface of the map, in voxels; 0 if the map is not looked at.
fn sigma_vox(arm: f32) -> f32 {
    if frame.crowd == 0.0 {
        return 0.0;
    }
    let place = clamp(place_of_arm(arm) - 0.5, 0.0, f32(ARMS - 1u));
    let low = u32(place);
    let a = bitcast<f32>(noise[1u + low]);
    let b = bitcast<f32>(noise[1u + min(low + 1u, ARMS - 1u)]);
    return a + (b - a) * (place - f32(low));
}

const BINS: u32 = BINS_PER_VOXEL * LOOK;

// A voxel near a place in the grid: how far it is along a normal, its distance to the surface, and 1 if it was observed.
fn read_along(center: vec3<f32>, normal: vec3<f32>, step: f32) -> vec3<f32> {
    let corner = floor(center + normal * step);
    let index = frame.anchor_voxel + vec3<i32>(corner);
    let slot = slot_of(index >> vec3(3u));
    if slot == NONE {
        return vec3(0.0);
    }
    let at = vec3<u32>(index & vec3(7));
    let voxel = load_voxel(slot, at.x | at.y << 3u | at.z << 6u);
    let distance = frame.truncation_vox * f32(bitcast<i32>(voxel.y)) / f32(max(voxel.x, 1u));
    return vec3(dot(corner + 0.5 - center, normal), distance, f32(voxel.x > 0u));
}

// How far in front of a place the map's surface is, along a normal, in voxels, the nearest first; 1000 if there is none near.
fn offset_of(center: vec3<f32>, normal: vec3<f32>) -> f32 {
    var ends = array(read_along(center, normal, 0.0), vec3(0.0));
    ends[1] = ends[0];
    for (var far = 1.0; far <= f32(LOOK); far += 1.0) {
        for (var side = 0u; side < 2u; side++) {
            let next = read_along(center, normal, select(-far, far, side == 0u));
            let behind = select(next, ends[side], side == 0u);
            let front = select(ends[side], next, side == 0u);
            if behind.z * front.z == 1.0 && behind.y < 0.0 && front.y >= 0.0 && front.x > behind.x {
                return behind.x + (front.x - behind.x) * behind.y / (behind.y - front.y);
            }
            ends[side] = next;
        }
    }
    return 1000.0;
}

// Whether the map holds another surface a little behind a place or in front of it, which faces the same way.
fn is_contradicted(center: vec3<f32>, normal: vec3<f32>) -> bool {
    for (var side = -1.0; side <= 1.0; side += 2.0) {
        var last = read_along(center, normal, side * f32(OWN_STEPS));
        for (var far = OWN_STEPS + 1u; far <= OTHER_STEPS; far++) {
            let next = read_along(center, normal, side * f32(far));
            let behind = select(next, last, side > 0.0);
            let front = select(last, next, side > 0.0);
            if behind.z * front.z == 1.0 && behind.y < 0.0 && front.y >= 0.0 {
                return true;
            }
            last = next;
        }
    }
    return false;
}

// Where the offset of each sampled return counts: its arm and its bin; NONE if it tells nothing.
@compute @workgroup_size(64)
fn sample_offsets(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var n = id.x; n * SAMPLE < frame.total; n += 64u * groups.x) {
        noise[n + SAMPLES_AT] = NONE;
        let i = cell_of(n * SAMPLE);
        if i == NONE || !is_plane(patches[i]) {
            continue;
        }
        let surface = patches[i];
        let center = center_of_patch(surface);
        if !center.is_there {
            continue;
        }
        let off = abs(offset_of(center.at, surface.normal));
        if off < f32(LOOK) {
            let bin = min(u32(off * f32(BINS_PER_VOXEL)), BINS - 1u);
            noise[n + SAMPLES_AT] = u32(place_of_arm(arm_m(surface))) * BINS + bin;
        }
    }
}

var<workgroup> offsets: array<atomic<u32>, ARMS * BINS>;
var<workgroup> sigmas: array<f32, ARMS>;

// The standard deviation of each arm from the median of its offsets; negative if there are too few.
fn sigma_of(arm: u32) -> f32 {
    var count = 0u;
    for (var bin = 0u; bin < BINS; bin++) {
        count += atomicLoad(&offsets[arm * BINS + bin]);
    }
    let half = 0.5 * f32(count);
    var below = 0.0;
    for (var bin = 0u; bin < BINS && count >= LEAST_OFFSETS; bin++) {
        let here = f32(atomicLoad(&offsets[arm * BINS + bin]));
        if below + here >= half {
            let sigma = OF_MEDIAN * (f32(bin) + (half - below) / here) / f32(BINS_PER_VOXEL);
            return sqrt(max(sigma * sigma - BLUR * BLUR, 0.0));
        }
        below += here;
    }
    return -1.0;
}

@compute @workgroup_size(256)
fn choose_agreement(@builtin(local_invocation_index) lane: u32) {
    for (var k = lane; k < ARMS * BINS; k += 256u) {
        atomicStore(&offsets[k], 0u);
    }
    workgroupBarrier();
    for (var n = lane; n * SAMPLE < frame.total; n += 256u) {
        let place = noise[n + SAMPLES_AT];
        if place != NONE {
            atomicAdd(&offsets[place], 1u);
        }
    }
    workgroupBarrier();
    if lane < ARMS {
        sigmas[lane] = sigma_of(lane);
    }
    workgroupBarrier();
    if lane == 0u {
        var last = 0.0;
        for (var arm = 0u; arm < ARMS; arm++) {
            last = select(last, sigmas[arm], sigmas[arm] >= 0.0);
            noise[1u + arm] = bitcast<u32>(last);
        }
    }
}
