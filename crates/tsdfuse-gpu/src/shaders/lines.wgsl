// Updating the voxels near thin lines, one thread per return: the walk of `tsdfuse::fuse::lines`.
//
// A method defines what a return becomes (`fuse_return`; mostly one line, see one_line.wgsl), how far voxels can be from a line
// (`reach_along`, `wide`) and which update each of them gets (`rule`).

// Outcomes of a return.
const FUSED: u32 = 0u;
const OUTSIDE_GRID: u32 = 1u;
const WITHOUT_NORMAL: u32 = 2u;
const WITHOUT_WEIGHT: u32 = 3u;
// Not counted.
const NO_RETURN: u32 = 4u;

// √3/2: the largest distance of a point in a voxel to its centre, in voxels (5.6).
const VOXEL_RADIUS: f32 = 0.8660254;
// Margin of the voxels that are examined, in voxels.
const SLACK: f32 = 0.01;

// A line along a unit vector through a place in the grid (a voxel, and the position in it).
struct Line {
    voxel: vec3<i32>,
    fraction: vec3<f32>,
    axis: vec3<f32>,
    // The largest distance of updated voxels from the centre along the line, in voxels.
    reach: f32,
    weight: f32,
    outcome: u32,
}

// A voxel near a line: the vector from the line's centre to the voxel's, in voxels; its part along the line; its squared length.
struct Near {
    offset: vec3<f32>,
    along: f32,
    distance2: f32,
}

// A return, and the direction and length of its ray.
struct Ray {
    end: vec3<f32>, // relative to the anchor's voxel, voxels
    direction: vec3<f32>,
    range_m: f32,
    outcome: u32,
}

fn ray_of(i: u32) -> Ray {
    return ray_to(i, point_of(i));
}

// The ray of a return as if it had been measured at this point (sensor frame).
fn ray_to(i: u32, point: vec3<f32>) -> Ray {
    if !is_valid(i) {
        return Ray(vec3(0.0), vec3(0.0), 0.0, OUTSIDE_GRID);
    }
    let placed = place_at(i, point);
    let along = placed.point - placed.origin;
    let range_m = length(along);
    let end = frame.anchor_fraction + placed.point * frame.voxels_per_m;
    if !(range_m > 0.0 && range_m < 1e9 && all(abs(end) < vec3(MAX_REACH))) {
        return Ray(vec3(0.0), vec3(0.0), 0.0, OUTSIDE_GRID);
    }
    return Ray(end, along / range_m, range_m, FUSED);
}

// A line through a place, in voxels relative to the anchor's voxel.
fn line(center: vec3<f32>, axis: vec3<f32>, weight: f32) -> Line {
    let voxel = floor(center);
    return Line(frame.anchor_voxel + vec3<i32>(voxel), center - voxel, axis, frame.truncation_vox, weight, FUSED);
}

// The line along a ray.
fn line_along(ray: Ray) -> Line {
    if ray.outcome != FUSED {
        return no_line(ray.outcome);
    }
    return line(ray.end, ray.direction, min(1.0 / ray.range_m, 1.0)); // (5.8)
}

fn no_line(outcome: u32) -> Line {
    return Line(vec3(0), vec3(0.0), vec3(0.0), 0.0, 0.0, outcome);
}

// The last block that this thread found, and its slot.
var<private> last_block: vec3<i32> = vec3(0x7fffffff);
var<private> last_slot: u32 = NONE;
// Whether this thread updated a voxel that might exceed the largest weight.
var<private> is_heavy: bool = false;

// The slot of a block that this scan updates. The block is listed the first time.
fn slot_to_update(block: vec3<i32>) -> u32 {
    let slot = slot_of(block);
    if slot == NONE {
        atomicAdd(&state.lost, 1u);
    } else {
        note_update(slot);
    }
    return slot;
}

// Creates the block of a voxel that will be updated, or updates the voxel. Sums are fixed-point, as in `tsdfuse::map`.
fn update(voxel: vec3<i32>, distance: f32, weight: f32) {
    let w = round(clamp(weight, 0.0, 1.0) * WEIGHT_SCALE);
    if w <= 0.0 {
        return;
    }
    let block = voxel >> vec3(3u);
    if any(block != last_block) {
        last_block = block;
        if frame.mode == ALLOCATE {
            allocate(block);
        } else {
            last_slot = slot_to_update(block);
        }
    }
    if frame.mode != ALLOCATE && last_slot != NONE {
        let at = vec3<u32>(voxel & vec3(7));
        let d = i32(round(clamp(distance, -1.0, 1.0) * w));
        let before = add_to_voxel(last_slot, at.x | at.y << 3u | at.z << 6u, u32(w), bitcast<u32>(d));
        is_heavy = is_heavy || before > frame.heavy_sum;
    }
}

// (m, u, w) from (x, y, z), m being the dominant axis, and back.
fn turned(v: vec3<f32>, dominant: u32) -> vec3<f32> {
    return select(select(v.zxy, v.yzx, dominant == 1u), v, dominant == 0u);
}

fn turned_back(v: vec3<f32>, dominant: u32) -> vec3<f32> {
    return select(select(v.yzx, v.zxy, dominant == 1u), v, dominant == 0u);
}

// The voxels near a line: plane by plane across its dominant axis, two or three wide along the other two.
fn walk(l: Line) {
    let a = abs(l.axis);
    let dominant = select(select(2u, 1u, a.y >= a.z), 0u, a.x >= a.y && a.x >= a.z);
    let axis = turned(l.axis, dominant);
    let fraction = turned(l.fraction, dominant);
    let slope = 1.0 / axis.x;
    let wide_u = wide(axis);
    let wide_w = wide(axis.xzy);
    let reach = reach_along(l, axis.x);
    let last = round(fraction.x + reach - 1.0);
    for (var plane = round(fraction.x - reach); plane <= last; plane += 1.0) {
        let t = (plane + 0.5 - fraction.x) * slope;
        let first_u = round(t * axis.y + fraction.y - 0.5 * wide_u);
        let first_w = round(t * axis.z + fraction.z - 0.5 * wide_w);
        for (var w = first_w; w < first_w + wide_w; w += 1.0) {
            for (var u = first_u; u < first_u + wide_u; u += 1.0) {
                let voxel = turned_back(vec3(plane, u, w), dominant);
                let offset = voxel + 0.5 - l.fraction;
                let products = offset * l.axis;
                let squares = offset * offset;
                let near = Near(offset, products.x + (products.y + products.z), squares.x + (squares.y + squares.z));
                let found = rule(l, near);
                if found.y > 0.0 {
                    update(l.voxel + vec3<i32>(voxel), found.x, found.y);
                }
            }
        }
    }
}

var<workgroup> outcomes: array<atomic<u32>, 5>;

// The workgroups for all returns are repeated for each thread that a method has per return.
@compute @workgroup_size(64)
fn fuse(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let groups = (frame.count + 63u) / 64u;
    let n = 64u * (group.x % groups) + lane;
    if atomicLoad(&state.flags) == 0u && n < frame.count {
        let outcome = fuse_return(frame.first + n, group.x / groups);
        if is_heavy {
            atomicOr(&state.heavy, 1u);
        }
        atomicAdd(&outcomes[outcome], 1u);
    }
    workgroupBarrier();
    if frame.mode != ALLOCATE && lane < 4u {
        let count = atomicLoad(&outcomes[lane]);
        if count != 0u {
            switch lane {
                case 0u: { atomicAdd(&state.fused, count); }
                case 1u: { atomicAdd(&state.outside_grid, count); }
                case 2u: { atomicAdd(&state.without_normal, count); }
                default: { atomicAdd(&state.without_weight, count); }
            }
        }
    }
}
