// Views of the map: one thread per pixel walks through the blocks, and through the cells of blocks with surface, to the first place
// where F falls from ≥ 0 to < 0. The hits are those of `tsdfuse::render`.
//
// Lengths are in voxels, places relative to the cell of the camera; cell c begins at the centre of voxel c.

struct View {
    // The camera's cell, and the camera's place in it.
    base: vec3<i32>,
    width: u32,
    origin: vec3<f32>,
    height: u32,
    // The columns of the rotation of world_from_camera.
    world_x: vec3<f32>,
    max_range_vox: f32,
    world_y: vec3<f32>,
    voxel_size_m: f32,
    world_z: vec3<f32>,
    pad: u32,
    // The box of all cells with surface.
    low: vec3<i32>,
    pad_low: u32,
    high: vec3<i32>,
    pad_high: u32,
}

// What a pixel sees, as in `tsdfuse::render::Hit`; a range of 0 means nothing.
struct Hit {
    normal: vec3<f32>,
    range_m: f32,
    depth_m: f32,
    incidence_cos: f32,
    weight: f32,
    pad: f32,
}

@group(1) @binding(5) var<uniform> view: View;
// The direction of each pixel (camera's axes), and the depth of a point at range 1 in that direction.
@group(1) @binding(6) var<storage, read> rays: array<vec4<f32>>;
@group(1) @binding(7) var<storage, read_write> hits: array<Hit>;

const ROUNDING: f32 = 1e-6;

fn voxel_near(slot: u32, v: vec3<i32>) -> vec2<u32> {
    return voxel_of(neighbours[27u * slot + block_number(v)], v);
}

fn corner(c: u32) -> vec3<i32> {
    return vec3<i32>(vec3(c & 1u, c >> 1u & 1u, c >> 2u));
}

// Values at the corners of a cell: the lower four in x, the upper four in y.
struct Corners {
    low: vec4<f32>,
    high: vec4<f32>,
}

fn trilinear(c: Corners, at: vec3<f32>) -> f32 {
    let layer = mix(c.low, c.high, at.z);
    let row = mix(layer.xz, layer.yw, at.x);
    return mix(row.x, row.y, at.y);
}

fn polynomial(c: vec4<f32>, u: f32) -> f32 {
    return c.x + u * (c.y + u * (c.z + u * c.w));
}

// The root between two places, where the function is monotone, by false position (Illinois).
fn root(c: vec4<f32>, from_u: f32, from_f: f32, to_u: f32, to_f: f32) -> f32 {
    if from_f <= 0.0 {
        return from_u;
    }
    var a = from_u;
    var fa = from_f;
    var b = to_u;
    var fb = to_f;
    var u = a;
    for (var n = 0; n < 16; n++) {
        u = a + (b - a) * (fa / (fa - fb));
        let f = polynomial(c, u);
        if abs(f) < ROUNDING {
            break;
        }
        if f > 0.0 {
            a = u;
            fa = f;
            fb *= 0.5;
        } else {
            b = u;
            fb = f;
            fa *= 0.5;
        }
    }
    return u;
}

// Where F first falls below 0 on the way from `enter` to `leave`, as a share of the way; negative if nowhere. F is a cubic there,
// monotone between its extrema.
fn crossing(c: Corners, enter: vec3<f32>, leave: vec3<f32>) -> f32 {
    let third = (leave - enter) / 3.0;
    let f = vec4(
        trilinear(c, enter), trilinear(c, enter + third), trilinear(c, enter + 2.0 * third), trilinear(c, leave),
    );
    // Newton's forward differences.
    let first = f.y - f.x;
    let second = f.z - 2.0 * f.y + f.x;
    let last = f.w - 3.0 * f.z + 3.0 * f.y - f.x;
    let k = vec4(f.x, first - 0.5 * second + last / 3.0, 0.5 * (second - last), last / 6.0);
    var ends = vec3(3.0);
    let inside = k.z * k.z - 3.0 * k.y * k.w;
    if inside > 0.0 {
        // This form does not cancel.
        let q = -(k.z + select(-sqrt(inside), sqrt(inside), k.z >= 0.0));
        var e = vec2(3.0);
        if abs(k.w) > 1e-30 {
            e.x = q / (3.0 * k.w);
        }
        if abs(q) > 1e-30 {
            e.y = k.y / q;
        }
        e = select(vec2(3.0), e, e > vec2(0.0) & e < vec2(3.0));
        ends = vec3(min(e.x, e.y), max(e.x, e.y), 3.0);
    }
    var from_u = 0.0;
    var from_f = f.x;
    for (var n = 0; n < 3; n++) {
        let u = ends[n];
        let here = select(polynomial(k, u), f.w, u == 3.0);
        let in_front = from_f >= select(0.0, -ROUNDING, from_u == 0.0);
        if in_front && here < 0.0 && here < from_f {
            return root(k, from_u, from_f, u, here) / 3.0;
        }
        from_u = u;
        from_f = here;
    }
    return -1.0;
}

// The gradient of F per voxel at a corner of a cell.
fn gradient(slot: u32, v: vec3<i32>) -> vec3<f32> {
    let here = distance_of(voxel_near(slot, v));
    var g = vec3(0.0);
    for (var axis = 0; axis < 3; axis++) {
        let along = vec3<i32>(vec3(axis == 0, axis == 1, axis == 2));
        let before = distance_of(voxel_near(slot, v - along));
        g[axis] = derivative(before, here, distance_of(voxel_near(slot, v + along)));
    }
    return g;
}

// What a ray hits in a cell with surface, between two ranges; `local` is the cell's place in the block, `cell` that in the view.
fn meet(slot: u32, local: vec3<i32>, cell: vec3<i32>, direction: vec3<f32>, enter_t: f32, leave_t: f32) -> Hit {
    var nothing: Hit;
    var f: array<f32, 8>;
    var w: array<f32, 8>;
    for (var c = 0u; c < 8u; c++) {
        let voxel = voxel_near(slot, local + corner(c));
        f[c] = distance_of(voxel);
        w[c] = f32(voxel.x) / WEIGHT_SCALE;
    }
    let start = view.origin - vec3<f32>(cell);
    let enter = clamp(start + direction * enter_t, vec3(0.0), vec3(1.0));
    let leave = clamp(start + direction * leave_t, vec3(0.0), vec3(1.0));
    let s = crossing(Corners(vec4(f[0], f[1], f[2], f[3]), vec4(f[4], f[5], f[6], f[7])), enter, leave);
    let range_vox = enter_t + (leave_t - enter_t) * s;
    if s < 0.0 || range_vox > view.max_range_vox {
        return nothing;
    }
    let at = mix(enter, leave, s);
    var g = vec3(0.0);
    for (var c = 0u; c < 8u; c++) {
        let near = vec3<f32>(corner(c));
        let share = mix(1.0 - at, at, near);
        g += gradient(slot, local + corner(c)) * (share.x * share.y * share.z);
    }
    let steep = length(g);
    // Where the field is flat, the ray's direction serves.
    let normal = select(-direction, g / max(steep, 1e-30), steep > 1e-20);
    let weight = trilinear(Corners(vec4(w[0], w[1], w[2], w[3]), vec4(w[4], w[5], w[6], w[7])), at);
    return Hit(normal, range_vox * view.voxel_size_m, 0.0, -dot(normal, direction), weight, 0.0);
}

fn least(v: vec3<f32>) -> f32 {
    return min(v.x, min(v.y, v.z));
}

fn first_hit(direction: vec3<f32>) -> Hit {
    var nothing: Hit;
    // Not exactly parallel to any axis, so that all quotients are finite.
    let up = direction >= vec3(0.0);
    let d = select(-max(-direction, vec3(1e-9)), max(direction, vec3(1e-9)), up);
    let inverse = 1.0 / d;
    let o = view.origin;
    let a = (vec3<f32>(view.low) - o) * inverse;
    let b = (vec3<f32>(view.high) - o) * inverse;
    let near = min(a, b);
    let end = min(least(max(a, b)), view.max_range_vox);
    var t = max(max(near.x, max(near.y, near.z)), 0.0);
    var cell = clamp(vec3<i32>(floor(o + d * t)), view.low, view.high - 1);
    while t < end {
        let block = (view.base + cell) >> vec3(3u);
        let first = (block << vec3(3u)) - view.base;
        let slot = slot_of(block);
        if slot != NONE && counts[slot].y > 0u {
            var c = cell;
            var at = t;
            while at < end && all(c >= first) && all(c < first + 8) {
                let sides = (vec3<f32>(c + select(vec3(0), vec3(1), up)) - o) * inverse;
                let leave = max(at, least(sides));
                let local = c - first;
                let row = rows[64u * slot + u32(local.y) + 8u * u32(local.z)];
                if (row >> (24u + u32(local.x)) & 1u) == 1u {
                    let hit = meet(slot, local, c, d, at, leave);
                    if hit.range_m > 0.0 {
                        return hit;
                    }
                }
                c += select(vec3(0), select(vec3(-1), vec3(1), up), sides <= vec3(leave));
                at = leave;
            }
        }
        // On to the next block: across the sides that are reached, or else to the block where the ray is now.
        let sides = (vec3<f32>(first + select(vec3(0), vec3(8), up)) - o) * inverse;
        t = max(t, least(sides));
        let inside = clamp(vec3<i32>(floor(o + d * t)), first, first + 7);
        cell = select(inside, select(first - 1, first + 8, up), sides <= vec3(t));
    }
    return nothing;
}

@compute @workgroup_size(8, 8)
fn render(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= view.width || id.y >= view.height {
        return;
    }
    let pixel = id.y * view.width + id.x;
    let ray = rays[pixel];
    var hit = first_hit(view.world_x * ray.x + view.world_y * ray.y + view.world_z * ray.z);
    hit.depth_m = hit.range_m * ray.w;
    hits[pixel] = hit;
}
