// One scan: where it was measured, and its returns. See frame.rs, which has the same layout.

// What a dispatch does.
const ALLOCATE: u32 = 0u;
const FUSE: u32 = 1u;

struct Frame {
    // The columns of the rotation of world_from_sensor.
    world_x: vec3<f32>,
    mode: u32,
    world_y: vec3<f32>,
    // The returns that this dispatch takes.
    first: u32,
    world_z: vec3<f32>,
    count: u32,
    // The sensor's position in the grid: voxel, and place in it.
    anchor_voxel: vec3<i32>,
    stamp: u32,
    anchor_fraction: vec3<f32>,
    voxels_per_m: f32,
    // How the sensor turns (its own axes, radians a second) and moves (world axes, metres a second).
    turn_axis: vec3<f32>,
    turn_rate: f32,
    velocity: vec3<f32>,
    truncation_vox: f32,
    max_weight_sum: u32,
    // A voxel with a larger weight sum might exceed that in this dispatch.
    heavy_sum: u32,
    // Where columns beside the points begin in `returns`; 0: there is none.
    times_at: u32,
    rings_at: u32,
    rings: u32,
    columns: u32,
    max_range_m: f32,
    min_dot: f32,
    // Returns of the whole scan.
    total: u32,
    // Of surface patches: see `tsdfuse::patch::Limits`; tangents of the angles between rings; nearest rings by elevation.
    window_m: f32,
    noise_m: f32,
    step_m: f32,
    max_gap_m: f32,
    // Angle between columns, and how many there are in a radian.
    column_rad: f32,
    columns_per_rad: f32,
    gaps_at: u32,
    nearest_at: u32,
    // Of cylindrical images, whose pitch is `column_rad`: unit vectors towards columns, for a phase of 0; the tangent of row 0; and
    // rows in a tangent of 1.
    towards_at: u32,
    top: f32,
    per_pitch: f32,
    // A camera's focal lengths, and its principal point, pixels.
    camera: vec4<f32>,
}

@group(1) @binding(0) var<uniform> frame: Frame;
// Points (sensor frame, metres), three numbers each, then the columns.
@group(1) @binding(1) var<storage, read> returns: array<u32>;

// A return in world axes relative to the anchor, metres, and where its ray began.
struct Placed {
    point: vec3<f32>,
    origin: vec3<f32>,
}

// Returns farther out, voxels from the sensor, do not reach the map.
const MAX_REACH: f32 = 4194304.0;

fn point_of(i: u32) -> vec3<f32> {
    let at = 3u * i;
    return bitcast<vec3<f32>>(vec3(returns[at], returns[at + 1u], returns[at + 2u]));
}

// Whether numbers are finite, from their bits: compilers may assume that all are.
fn is_finite(bits: vec3<u32>) -> bool {
    return all((bits & vec3(0x7f800000u)) != vec3(0x7f800000u));
}

// Whether a return has a place.
fn is_valid(i: u32) -> bool {
    let at = 3u * i;
    var valid = is_finite(vec3(returns[at], returns[at + 1u], returns[at + 2u]));
    if frame.times_at != 0u {
        valid = valid && is_finite(vec3(returns[frame.times_at + i]));
    }
    return valid;
}

// Sine and cosine of an angle of at most a few turns: built-in ones may be off by 2⁻¹¹.
fn sin_cos(angle: f32) -> vec2<f32> {
    let quarter = round(angle * 0.63661977);
    // π/2 in two parts.
    let r = (angle - quarter * 1.5707964) + quarter * 4.371139e-8;
    let r2 = r * r;
    let s = r * (1.0 - r2 / 6.0 * (1.0 - r2 / 20.0 * (1.0 - r2 / 42.0 * (1.0 - r2 / 72.0))));
    let c = 1.0 - r2 / 2.0 * (1.0 - r2 / 12.0 * (1.0 - r2 / 30.0 * (1.0 - r2 / 56.0 * (1.0 - r2 / 90.0))));
    switch i32(quarter) & 3 {
        case 0: { return vec2(s, c); }
        case 1: { return vec2(c, -s); }
        case 2: { return vec2(-s, -c); }
        default: { return vec2(-c, s); }
    }
}

// Places a valid return from where the sensor was when it was measured.
fn place(i: u32) -> Placed {
    return place_at(i, point_of(i));
}

// A vector in the sensor's axes at the scan's pose, from those that it has some seconds later.
fn turned_after(p: vec3<f32>, secs: f32) -> vec3<f32> {
    // Rodrigues' rotation formula.
    let turn = sin_cos(frame.turn_rate * secs);
    let k = frame.turn_axis;
    return p * turn.y + cross(k, p) * turn.x + k * (dot(k, p) * (1.0 - turn.y));
}

// Places a point (sensor frame) as if it were a return's.
fn place_at(i: u32, point: vec3<f32>) -> Placed {
    var p = point;
    var origin = vec3(0.0);
    if frame.times_at != 0u {
        let secs = bitcast<f32>(returns[frame.times_at + i]);
        p = turned_after(p, secs);
        origin = frame.velocity * secs;
    }
    return Placed(frame.world_x * p.x + frame.world_y * p.y + frame.world_z * p.z + origin, origin);
}

// Axes of the sensor at the scan's pose, from world axes.
fn to_sensor(v: vec3<f32>) -> vec3<f32> {
    return vec3(dot(frame.world_x, v), dot(frame.world_y, v), dot(frame.world_z, v));
}

// Half the diagonal of a block, in voxels.
const BLOCK_RADIUS: f32 = 6.928203;

// The first corner of a block, voxels from the anchor.
fn corner_of(block: vec3<i32>) -> vec3<f32> {
    return vec3<f32>((block << vec3(3u)) - frame.anchor_voxel) - frame.anchor_fraction;
}

// Lists a block that this scan updates, the first time.
fn note_update(slot: u32) {
    if atomicLoad(&blocks[slot].stamp) != frame.stamp && atomicExchange(&blocks[slot].stamp, frame.stamp) != frame.stamp {
        list_update(slot);
    }
}
