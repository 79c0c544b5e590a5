// One scan: where it was measured, and its returns. frame.rs has the same layout.

// Modes of a dispatch.
const ALLOCATE: u32 = 0u;
const FUSE: u32 = 1u;

struct Frame {
    // The columns of the rotation of world_from_sensor.
    world_x: vec3<f32>,
    mode: u32,
    world_y: vec3<f32>,
    // The returns that this dispatch processes: the first, and how many.
    first: u32,
    world_z: vec3<f32>,
    count: u32,
    // The sensor's position in the grid: the voxel, and the place in it.
    anchor_voxel: vec3<i32>,
    stamp: u32,
    anchor_fraction: vec3<f32>,
    voxels_per_m: f32,
    truncation_vox: f32,
    max_weight_sum: u32,
    // A voxel with a larger weight sum than this might exceed `max_weight_sum` in this dispatch.
    heavy_sum: u32,
    // Offsets in `returns` of the columns after the points; 0 if there is none.
    times_at: u32,
    // The offset of the segments of the sensor's motion, and their number; used if there are times.
    segments_at: u32,
    segments: u32,
    rings_at: u32,
    rings: u32,
    columns: u32,
    max_range_m: f32,
    min_dot: f32,
    // Returns of the whole scan.
    total: u32,
    // For surface patches: see `tsdfuse::patch::Limits`; further down, offsets of the tangents of the angles between rings and of the
    // nearest rings by elevation.
    window_m: f32,
    noise_m: f32,
    step_m: f32,
    max_gap_m: f32,
    // The angle between columns, and the number of columns per radian.
    column_rad: f32,
    columns_per_rad: f32,
    gaps_at: u32,
    nearest_at: u32,
    // For cylindrical images, whose pitch is `column_rad`: the offset of unit vectors towards columns, for a phase of 0; the tangent of
    // row 0; and the number of rows per tangent of 1.
    towards_at: u32,
    top: f32,
    per_pitch: f32,
    // For surface patches: how many of them meet in a voxel that faces the sensor 1 m away; 0 if the map is not looked at.
    crowd: f32,
    // Returns are neighbours if they are at most this many cells apart along a row or a column, and the cells between are empty.
    neighbour_cells: u32,
    // A camera's focal lengths, and its principal point, pixels.
    camera: vec4<f32>,
}

@group(1) @binding(0) var<uniform> frame: Frame;
// Points (sensor frame, metres), three numbers each, then the columns.
@group(1) @binding(1) var<storage, read> returns: array<u32>;

// A return and the start of its ray, world axes relative to the anchor, metres.
struct Placed {
    point: vec3<f32>,
    origin: vec3<f32>,
}

// Returns farther from the sensor than this many voxels do not reach the map.
const MAX_REACH: f32 = 4194304.0;

fn point_of(i: u32) -> vec3<f32> {
    let at = 3u * i;
    return bitcast<vec3<f32>>(vec3(returns[at], returns[at + 1u], returns[at + 2u]));
}

// Whether numbers are finite, from their bits: shader compilers may assume that all numbers are.
fn is_finite(bits: vec3<u32>) -> bool {
    return all((bits & vec3(0x7f800000u)) != vec3(0x7f800000u));
}

// Whether a return can be placed.
fn is_valid(i: u32) -> bool {
    let at = 3u * i;
    var valid = is_finite(vec3(returns[at], returns[at + 1u], returns[at + 2u]));
    if frame.times_at != 0u {
        valid = valid && is_finite(vec3(returns[frame.times_at + i]));
    }
    return valid;
}

// Sine and cosine of an angle of at most a few turns. The built-in functions may be off by 2⁻¹¹.
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

// The motion of the sensor consists of segments, in order of time, in which it moves and turns at constant rates. In `returns` a
// segment is these words: see sweep.rs.
const UNTIL_SECS: u32 = 0u;
// The segment starts at the pose nearer to time 0: at this time, …
const FROM_SECS: u32 = 1u;
const TURN_RATE: u32 = 2u;
// … at this place relative to the scan's position, with this velocity (world axes), …
const SHIFT: u32 = 3u;
const VELOCITY: u32 = 6u;
// … turning about this axis, from this rotation (a quaternion) relative to the scan's pose.
const TURN_AXIS: u32 = 9u;
const ROTATION: u32 = 12u;
const SEGMENT_WORDS: u32 = 16u;

fn float_at(at: u32) -> f32 {
    return bitcast<f32>(returns[at]);
}

fn vector_at(at: u32) -> vec3<f32> {
    return vec3(float_at(at), float_at(at + 1u), float_at(at + 2u));
}

// Where the segment begins in `returns` in which a time lies, seconds after the scan's pose.
fn segment_at(secs: f32) -> u32 {
    var segment = frame.segments_at;
    let last = segment + SEGMENT_WORDS * (frame.segments - 1u);
    while segment < last && float_at(segment + UNTIL_SECS) < secs {
        segment += SEGMENT_WORDS;
    }
    return segment;
}

// Rotates a vector about a unit vector, by an angle given as sine and cosine: Rodrigues' rotation formula.
fn rotated_about(axis: vec3<f32>, turn: vec2<f32>, p: vec3<f32>) -> vec3<f32> {
    return p * turn.y + cross(axis, p) * turn.x + axis * (dot(axis, p) * (1.0 - turn.y));
}

// Rotates a vector by a unit quaternion, given as vector and scalar part.
fn rotated(v: vec3<f32>, w: f32, p: vec3<f32>) -> vec3<f32> {
    return p + 2.0 * cross(v, cross(v, p) + w * p);
}

// How far the sensor has turned since a segment's start: sine and cosine.
fn turn_in(segment: u32, secs: f32) -> vec2<f32> {
    return sin_cos(float_at(segment + TURN_RATE) * (secs - float_at(segment + FROM_SECS)));
}

// A vector in the sensor's axes at the scan's pose, from its axes at another time.
fn to_first_axes(p: vec3<f32>, segment: u32, secs: f32) -> vec3<f32> {
    let turned = rotated_about(vector_at(segment + TURN_AXIS), turn_in(segment, secs), p);
    return rotated(vector_at(segment + ROTATION), float_at(segment + ROTATION + 3u), turned);
}

// The inverse of `to_first_axes`.
fn from_first_axes(p: vec3<f32>, segment: u32, secs: f32) -> vec3<f32> {
    let unrotated = rotated(-vector_at(segment + ROTATION), float_at(segment + ROTATION + 3u), p);
    let turn = turn_in(segment, secs);
    return rotated_about(vector_at(segment + TURN_AXIS), vec2(-turn.x, turn.y), unrotated);
}

// Where the sensor is at some time, relative to the scan's position, world axes.
fn shift_at(segment: u32, secs: f32) -> vec3<f32> {
    return vector_at(segment + SHIFT) + vector_at(segment + VELOCITY) * (secs - float_at(segment + FROM_SECS));
}

// When a return was measured, seconds after the scan's pose. Only if there are times.
fn time_of(i: u32) -> f32 {
    return float_at(frame.times_at + i);
}

// Places a point (sensor frame) as if it were a return's.
fn place_at(i: u32, point: vec3<f32>) -> Placed {
    var p = point;
    var origin = vec3(0.0);
    if frame.times_at != 0u {
        let secs = time_of(i);
        let segment = segment_at(secs);
        p = to_first_axes(p, segment, secs);
        origin = shift_at(segment, secs);
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

// Lists a block that this scan updates, when called for the first time.
fn note_update(slot: u32) {
    if atomicLoad(&blocks[slot].stamp) != frame.stamp && atomicExchange(&blocks[slot].stamp, frame.stamp) != frame.stamp {
        list_update(slot);
    }
}
