// Local surface normals, from the four neighbours in the organized image: see `tsdfuse::fuse::normals` and
// `tsdfuse::normals::adjacent`.

// Unit vectors whose sum is shorter than this cancel each other.
const CANCELLED: f32 = 1e-3;

// The vector from a return to the one in another cell; w: whether there is one.
fn edge_to(p: vec3<f32>, ring: u32, column: u32) -> vec4<f32> {
    if ring >= frame.rings {
        return vec4(0.0);
    }
    let cell = cells[ring * frame.columns + column];
    if !is_there(cell) {
        return vec4(0.0, 0.0, 0.0, select(0.0, -1.0, cell.i == INVALID));
    }
    return vec4(cell.point - p, 1.0);
}

// The unit normal of a triangle; w: whether it has one.
fn triangle(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    let n = cross(a.xyz, b.xyz);
    let size = length(n);
    let is_flat = a.w <= 0.0 || b.w <= 0.0 || size <= 0.0;
    return vec4(select(n / max(size, 1e-37), vec3(0.0), is_flat), select(1.0, 0.0, is_flat));
}

fn similar(a: vec4<f32>, b: vec4<f32>) -> bool {
    return a.w * b.w > 0.0 && dot(a.xyz, b.xyz) > frame.min_dot;
}

// The normal that faces the sensor, and how well the triangles agree (5.17); 0 if there is no normal.
fn normal_of(i: u32, p: vec3<f32>, ray: vec3<f32>) -> vec4<f32> {
    let cell = cell_of(i);
    if cell == NONE {
        return vec4(0.0);
    }
    let ring = cell / frame.columns;
    let column = cell % frame.columns;
    // In cyclic order, so that each two in a row span an adjacent triangle [E3]. Ring 0 − 1 wraps around to no ring.
    let e0 = edge_to(p, ring - 1u, column);
    let e1 = edge_to(p, ring, next_column(column));
    let e2 = edge_to(p, ring + 1u, column);
    let e3 = edge_to(p, ring, column_before(column));
    if e0.w * e1.w * e2.w * e3.w == 0.0 {
        return vec4(0.0); // all four must be there
    }
    let t0 = triangle(e0, e1);
    let t1 = triangle(e1, e2);
    let t2 = triangle(e2, e3);
    let t3 = triangle(e3, e0);
    // N_S: the triangles that are similar to at least one other.
    let chosen = vec4<f32>(vec4(
        similar(t0, t1) || similar(t0, t2) || similar(t0, t3),
        similar(t0, t1) || similar(t1, t2) || similar(t1, t3),
        similar(t0, t2) || similar(t1, t2) || similar(t2, t3),
        similar(t0, t3) || similar(t1, t3) || similar(t2, t3),
    ));
    let sum = t0.xyz * chosen.x + t1.xyz * chosen.y + t2.xyz * chosen.z + t3.xyz * chosen.w;
    let size = length(sum);
    if !(size > CANCELLED) {
        return vec4(0.0);
    }
    let normal = sum / size; // (5.13)
    let angles = vec4(
        arc_cosine(dot(t0.xyz, normal)), arc_cosine(dot(t1.xyz, normal)),
        arc_cosine(dot(t2.xyz, normal)), arc_cosine(dot(t3.xyz, normal)),
    );
    let agreement = max(1.0 - dot(angles, chosen) / PI, 0.0); // (5.17)
    return vec4(select(normal, -normal, dot(normal, ray) > 0.0), agreement); // [E4]
}

fn line_of(i: u32) -> Line {
    let ray = ray_of(i);
    if ray.outcome != FUSED {
        return no_line(ray.outcome);
    }
    let found = normal_of(i, place(i).point, ray.direction);
    if all(found.xyz == vec3(0.0)) {
        return no_line(WITHOUT_NORMAL);
    }
    let by_range = 1.0 - ray.range_m / frame.max_range_m; // (5.18)
    let by_incidence = 1.0 - 2.0 * arc_cosine(-dot(ray.direction, found.xyz)) / PI; // (5.19)
    let weight = found.w * by_range * by_incidence; // (5.20)
    if !(weight > 0.0) {
        return no_line(WITHOUT_WEIGHT);
    }
    return line(ray.end, found.xyz, weight);
}

// The distance divided by μ, and the weight; a weight of 0 means no update.
fn rule(l: Line, v: Near) -> vec2<f32> {
    let inside = v.distance2 - v.along * v.along <= VOXEL_RADIUS * VOXEL_RADIUS && abs(v.along) <= frame.truncation_vox; // (5.14)(5.15)
    return vec2(v.along / frame.truncation_vox, select(0.0, l.weight, inside)); // (5.16)
}
