// The plane that each return lies on, from the returns in a window around its cell: see `tsdfuse::patch`, and constants.rs for the
// tuning constants.

// The tangent of the angle between a ring and the next.
fn ring_gap(ring: u32) -> f32 {
    return bitcast<f32>(returns[frame.gaps_at + ring]);
}

struct Patch {
    // A point of the surface, world axes relative to the anchor, metres.
    center: vec3<f32>,
    kind: u32,
    // Faces the sensor; zero for a return without a plane.
    normal: vec3<f32>,
    // It takes part in one of so many scans (TIMES); with WAITS, in none now; and which links to neighbours are not made.
    turn: u32,
}

const TIMES: u32 = 0xffu;
const WAITS: u32 = 0x100u;
// The map contradicts the wide links to the next ring and to the next column.
const CONTRADICTED_IN_COLUMN: u32 = 0x200u;
const CONTRADICTED_IN_ROW: u32 = 0x400u;

// What is known about the surface at a patch: nothing, the end of a ray, a plane through half of the window, or through all of it.
const NOWHERE: u32 = 0u;
const RAY: u32 = 1u;
const HALF: u32 = 2u;
const WHOLE: u32 = 3u;

@group(1) @binding(6) var<storage, read_write> patches: array<Patch>;
// The standard deviation of ranges; those of offsets from the map, by arms (agreement.wgsl); then, for each sampled return, the squared
// noise that its window shows (infinite where it shows none), and later where its offset counts.
@group(1) @binding(7) var<storage, read_write> noise: array<u32>;

const SAMPLES_AT: u32 = ARMS + 1u;
const INFINITE: u32 = 0x7f800000u;

fn is_plane(surface: Patch) -> bool {
    return surface.kind >= HALF;
}

// The standard deviation of ranges, metres.
fn noise_m() -> f32 {
    if frame.noise_m > 0.0 {
        return frame.noise_m;
    }
    return bitcast<f32>(noise[0]);
}

// A window around a cell; its reach to lower rings, higher rings, lower columns and higher columns.
struct Window {
    ring: u32,
    column: u32,
    reach: vec4<u32>,
}

// The sides of the window that each half of it keeps.
const HALVES = array(vec4(1u, 1u, 1u, 0u), vec4(1u, 1u, 0u, 1u), vec4(1u, 0u, 1u, 1u), vec4(0u, 1u, 1u, 1u));

fn window_about(cell: u32, range_m: f32) -> Window {
    let ring = cell / frame.columns;
    let steps = max(vec2(ring_gap(ring), frame.column_rad), vec2(1e-4)) * max(range_m, 1e-30);
    let most = vec2(f32(MAX_RINGS), f32(MAX_COLUMNS));
    let far = vec2<u32>(clamp(frame.window_m / steps + 0.5, vec2(1.0), most));
    let reach = vec4(min(far.x, ring), min(far.x, frame.rings - 1u - ring), far.y, far.y);
    return Window(ring, cell % frame.columns, reach);
}

// Least squares over the returns of a window: see `tsdfuse::patch::plane`.
struct Plane {
    normal: vec3<f32>,
    // Relative to the return in the middle.
    mean: vec3<f32>,
    residual2: f32,
    spread2: f32,
    count: f32,
}

// The sums are relative to the return in the middle, so that no large parts cancel.
fn plane_of(window: Window, middle: vec3<f32>) -> Plane {
    var count = 0.0;
    var sum = vec3(0.0);
    var squares = vec3(0.0); // xx, yy, zz
    var products = vec3(0.0); // xy, xz, yz
    let left = (window.column + MAX_COLUMNS * frame.columns - window.reach.z) % frame.columns;
    for (var ring = window.ring - window.reach.x; ring <= window.ring + window.reach.y; ring++) {
        var column = left;
        for (var n = 0u; n <= window.reach.z + window.reach.w; n++) {
            let cell = cells[ring * frame.columns + column];
            if is_there(cell) {
                let p = cell.point - middle;
                count += 1.0;
                sum += p;
                squares += p * p;
                products += p.xxy * p.yzz;
            }
            column = next_column(column);
        }
    }
    let inverse = 1.0 / max(count, 1.0);
    let mean = sum * inverse;
    return fit(Symmetric(squares * inverse - mean * mean, products * inverse - mean.xxy * mean.yzz), mean, count);
}

// A symmetric matrix: xx, yy, zz and xy, xz, yz.
struct Symmetric {
    diagonal: vec3<f32>,
    beside: vec3<f32>,
}

// The columns of a symmetric matrix.
fn columns_of(m: Symmetric) -> mat3x3<f32> {
    let b = m.beside;
    return mat3x3(vec3(m.diagonal.x, b.xy), vec3(b.x, m.diagonal.y, b.z), vec3(b.yz, m.diagonal.z));
}

// The square of a matrix that is first scaled to a trace of 1.
fn squared(m: Symmetric) -> Symmetric {
    let scale = 1.0 / max(m.diagonal.x + m.diagonal.y + m.diagonal.z, 1e-37);
    let c = columns_of(Symmetric(m.diagonal * scale, m.beside * scale));
    return Symmetric(vec3(dot(c[0], c[0]), dot(c[1], c[1]), dot(c[2], c[2])), vec3(dot(c[0], c[1]), dot(c[0], c[2]), dot(c[1], c[2])));
}

// The plane of a covariance. The normal is the eigenvector of the least eigenvalue, which dominates a high power of the cofactors.
fn fit(covariance: Symmetric, mean: vec3<f32>, count: f32) -> Plane {
    let d = covariance.diagonal;
    let b = covariance.beside;
    let cofactors = Symmetric(d.yxx * d.zzy - b.zyx * b.zyx, b.yxx * b.zzy - b.xyz * d.zyx);
    let power = squared(squared(squared(cofactors)));
    let c = columns_of(power);
    let p = power.diagonal;
    let longest = select(select(c[2], c[1], p.y >= p.z), c[0], p.x >= p.y && p.x >= p.z);
    let normal = longest / max(length(longest), 1e-37);
    let least = max(dot(columns_of(covariance) * normal, normal), 0.0);
    // The sum and the product of the other two eigenvalues.
    let sum = d.x + d.y + d.z - least;
    let product = cofactors.diagonal.x + cofactors.diagonal.y + cofactors.diagonal.z - least * sum;
    let greater = 0.5 * (sum + sqrt(max(sum * sum - 4.0 * product, 0.0)));
    return Plane(normal, mean, least * count / max(count - 3.0, 1.0), product / max(greater, 1e-37), count);
}

// A return's patch, and its mean squared residual; infinite if the return does not lie on a plane.
struct Found {
    surface: Patch,
    residual2: f32,
}

fn judge(plane: Plane, kind: u32, point: vec3<f32>, ray: vec3<f32>) -> Found {
    let facing = dot(ray, plane.normal);
    let off = dot(plane.normal, plane.mean);
    let cosine2 = facing * facing / max(dot(ray, ray), 1e-37);
    let noise2 = noise_m() * noise_m();
    // The expected residual across the plane: the part of the noise that does not lie in the plane.
    let noise2_across = noise2 * cosine2;
    let expected2 = noise2_across + ROUGHNESS_M * ROUGHNESS_M;
    let is_surface = plane.count >= MIN_RETURNS
        && plane.residual2 <= MAX_RESIDUAL * MAX_RESIDUAL * expected2
        && off * off <= MAX_OFF * MAX_OFF * expected2
        && plane.spread2 >= MIN_SPREAD * MIN_SPREAD * max(plane.residual2, noise2)
        && cosine2 >= MIN_COSINE * MIN_COSINE;
    if !is_surface {
        return Found(Patch(point, RAY, vec3(0.0), 1u), bitcast<f32>(INFINITE));
    }
    let normal = select(plane.normal, -plane.normal, facing > 0.0);
    // Of the distance from the plane, the part that is noise is removed, and the part that is shape stays.
    let noise = min(noise2_across / max(plane.residual2, 1e-37), 1.0);
    return Found(Patch(point + plane.normal * (noise * off), kind, normal, 1u), plane.residual2);
}

// The squared noise that the windows of some returns show.
@compute @workgroup_size(64)
fn sample_noise(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var n = id.x; n * SAMPLE < frame.total; n += 64u * groups.x) {
        noise[n + SAMPLES_AT] = INFINITE;
        let i = cell_of(n * SAMPLE);
        if i == NONE || !is_there(cells[i]) {
            continue;
        }
        let point = cells[i].point;
        let ray = point - origin_of(cells[i]);
        let range_m = length(ray);
        let plane = plane_of(window_about(i, range_m), point);
        let cosine = dot(ray, plane.normal) / max(range_m, 1e-30);
        if plane.count >= MIN_TELLING && abs(cosine) >= FACING {
            noise[n + SAMPLES_AT] = bitcast<u32>(abs(plane.residual2 / (cosine * cosine)));
        }
    }
}

var<workgroup> histogram: array<atomic<u32>, 256>;
// The known bits of the value that is searched for, and how many of the values that share these bits are below it.
var<workgroup> known: u32;
var<workgroup> below: u32;

// The third of the windows with the least noise is assumed to be surface, and its largest noise is the result. The bits of numbers that
// are not negative have the numbers' order, so the result is found eight bits at a time.
@compute @workgroup_size(256)
fn choose_noise(@builtin(local_invocation_index) lane: u32) {
    let count = (frame.total + SAMPLE - 1u) / SAMPLE;
    for (var n = lane; n < count; n += 256u) {
        atomicAdd(&histogram[0], select(0u, 1u, noise[n + SAMPLES_AT] < INFINITE));
    }
    workgroupBarrier();
    let telling = atomicLoad(&histogram[0]);
    if lane == 0u {
        below = telling / 3u;
    }
    for (var shift = 32u; shift > 0u; ) {
        shift -= 8u;
        workgroupBarrier();
        atomicStore(&histogram[lane], 0u);
        workgroupBarrier();
        for (var n = lane; n < count; n += 256u) {
            let bits = noise[n + SAMPLES_AT];
            // Avoids a shift by 32 bits.
            if bits < INFINITE && (bits >> shift) >> 8u == (known >> shift) >> 8u {
                atomicAdd(&histogram[bits >> shift & 255u], 1u);
            }
        }
        workgroupBarrier();
        var fewer = 0u;
        for (var b = 0u; b < lane; b++) {
            fewer += atomicLoad(&histogram[b]);
        }
        let wanted = below;
        workgroupBarrier();
        if fewer <= wanted && wanted < fewer + atomicLoad(&histogram[lane]) {
            known |= lane << shift;
            below = wanted - fewer;
        }
    }
    workgroupBarrier();
    if lane == 0u {
        let told = clamp(sqrt(bitcast<f32>(known)), LEAST_NOISE_M, MOST_NOISE_M);
        noise[0] = bitcast<u32>(select(told, MOST_NOISE_M, telling == 0u));
    }
}

// The patch of each cell's return: from its whole window, or else from the half with the least residual.
@compute @workgroup_size(64)
fn find_planes(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < frame.rings * frame.columns; i += 64u * groups.x) {
        let cell = cells[i];
        if !is_there(cell) {
            patches[i].kind = NOWHERE;
            continue;
        }
        let ray = cell.point - origin_of(cell);
        let window = window_about(i, length(ray));
        let whole = plane_of(window, cell.point);
        var best = judge(whole, WHOLE, cell.point, ray);
        // Halves have even fewer returns.
        if !is_plane(best.surface) && whole.count >= MIN_RETURNS {
            for (var k = 0; k < 4; k++) {
                let half = Window(window.ring, window.column, window.reach * HALVES[k]);
                let found = judge(plane_of(half, cell.point), HALF, cell.point, ray);
                if found.residual2 < best.residual2 {
                    best = found;
                }
            }
        }
        patches[i] = best.surface;
    }
}
