// Writes the vertices and triangles of the blocks with surface, in the order of the list.
//
// A vertex belongs to the block that contains the lower end of its grid edge. Its number there follows from counting bits, so
// neighbours need no table to find it.

// Slot, first vertex and first triangle of each block with surface.
@group(1) @binding(5) var<storage, read> list: array<vec3<u32>>;
// The first vertex of each block, by slot.
@group(1) @binding(6) var<storage, read> first_vertices: array<u32>;
// Six numbers per vertex: its place relative to the centre of the block's first voxel, in voxels, and its normal.
@group(1) @binding(7) var<storage, read_write> vertices: array<f32>;
// Three numbers per triangle.
@group(1) @binding(8) var<storage, read_write> triangles: array<u32>;

// Vertices keep this distance, in voxels, from the voxel centres.
const MARGIN: f32 = 1e-3;

// F of voxels −1 … 9.
const TILE: i32 = 11;
var<workgroup> tile: array<f32, 1331>;
// Rows of the block and of those after it along one axis or more (x, y, z: bits of the number), and the number of the first
// vertex of each row.
var<workgroup> edges: array<u32, 512>;
var<workgroup> numbers: array<u32, 512>;
// The first triangle of each row.
var<workgroup> offsets: array<u32, 64>;

fn tile_at(v: vec3<i32>) -> i32 {
    return (v.x + 1) + TILE * ((v.y + 1) + TILE * (v.z + 1));
}

fn gradient(v: vec3<i32>) -> vec3<f32> {
    let at = tile_at(v);
    let here = tile[at];
    return vec3(
        derivative(tile[at - 1], here, tile[at + 1]),
        derivative(tile[at - TILE], here, tile[at + TILE]),
        derivative(tile[at - TILE * TILE], here, tile[at + TILE * TILE]),
    );
}

// The number of the vertex on an edge of the cell at `cell`: edge 4·axis + k begins at the k-th corner whose bit `axis` is 0.
fn number_of(cell: vec3<i32>, edge: u32) -> u32 {
    let axis = edge >> 2u;
    let k = edge & 3u;
    let low = k & ((1u << axis) - 1u);
    let corner = low | (k - low) << 1u;
    let v = cell + vec3<i32>(vec3(corner & 1u, corner >> 1u & 1u, corner >> 2u));
    let after = vec3<u32>(v >> vec3(3u));
    let l = vec3<u32>(v & vec3(7));
    let row = 64u * (after.x | after.y << 1u | after.z << 2u) + (l.y | l.z << 3u);
    let bit = 3u * l.x + axis;
    return numbers[row] + countOneBits(edges[row] & ((1u << bit) - 1u));
}

@compute @workgroup_size(64)
fn write_mesh(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var n = group.x; n < surface.count; n += groups.x) {
        let item = list[surface.first + n];
        if lane < 27u {
            near[lane] = neighbours[27u * item.x + lane];
        }
        workgroupBarrier();
        for (var i = i32(lane); i < TILE * TILE * TILE; i += 64) {
            let v = vec3(i % TILE, i / TILE % TILE, i / (TILE * TILE)) - 1;
            tile[i] = distance_of(voxel_of(near[block_number(v)], v));
        }
        for (var b = 0u; b < 8u; b++) {
            let slot = near[13u + (b & 1u) + 3u * (b >> 1u & 1u) + 9u * (b >> 2u)];
            var row = 0u;
            if slot != NONE {
                row = rows[64u * slot + lane];
            }
            edges[64u * b + lane] = row & EDGES;
            numbers[64u * b + lane] = countOneBits(row & EDGES);
            if b == 0u {
                offsets[lane] = row >> 24u;
            }
        }
        workgroupBarrier();
        // Eight sums, one thread each, and one more for the triangles.
        let y = i32(lane & 7u);
        let z = i32(lane >> 3u);
        let crossed = offsets[lane];
        var own_triangles = 0u;
        for (var x = 0; x < 8; x++) {
            if (crossed >> u32(x) & 1u) == 1u {
                own_triangles += cases[case_of(vec3(x, y, z))].x;
            }
        }
        workgroupBarrier();
        offsets[lane] = own_triangles;
        workgroupBarrier();
        if lane < 8u {
            let slot = near[13u + (lane & 1u) + 3u * (lane >> 1u & 1u) + 9u * (lane >> 2u)];
            var next = 0u;
            if slot != NONE {
                next = first_vertices[slot];
            }
            for (var r = 64u * lane; r < 64u * lane + 64u; r++) {
                let here = numbers[r];
                numbers[r] = next;
                next += here;
            }
        } else if lane == 8u {
            var next = item.z - surface.first_triangle;
            for (var r = 0; r < 64; r++) {
                let here = offsets[r];
                offsets[r] = next;
                next += here;
            }
        }
        workgroupBarrier();

        var number = numbers[lane] - surface.first_vertex;
        for (var left = edges[lane]; left != 0u; left &= left - 1u) {
            let bit = countTrailingZeros(left);
            write_vertex(number, vec3(i32(bit / 3u), y, z), bit % 3u);
            number += 1u;
        }
        var at = 3u * offsets[lane];
        for (var left = crossed; left != 0u; left &= left - 1u) {
            let cell = vec3(i32(countTrailingZeros(left)), y, z);
            let drawn = cases[case_of(cell)];
            for (var k = 0u; k < 3u * drawn.x; k++) {
                let edge = select(drawn.z >> (4u * (k - 8u)), drawn.y >> (4u * k), k < 8u) & 15u;
                triangles[at] = number_of(cell, edge);
                at += 1u;
            }
        }
        workgroupBarrier();
    }
}

// The case of a cell: bit c for each corner c behind the surface.
fn case_of(cell: vec3<i32>) -> u32 {
    var found = 0u;
    for (var c = 0u; c < 8u; c++) {
        let v = cell + vec3<i32>(vec3(c & 1u, c >> 1u & 1u, c >> 2u));
        found |= select(0u, 1u, tile[tile_at(v)] < 0.0) << c;
    }
    return found;
}

fn write_vertex(number: u32, v: vec3<i32>, axis: u32) {
    let along = vec3<i32>(vec3(axis == 0u, axis == 1u, axis == 2u));
    let f0 = tile[tile_at(v)];
    let f1 = tile[tile_at(v + along)];
    let t = clamp(f0 / (f0 - f1), MARGIN, 1.0 - MARGIN);
    let g = gradient(v) * (1.0 - t) + gradient(v + along) * t;
    let steep = length(g);
    // Where the field is flat, the edge's direction serves.
    let flat_normal = vec3<f32>(along) * select(-1.0, 1.0, f1 > f0);
    let normal = select(flat_normal, g / max(steep, 1e-30), steep > 1e-20);
    let place = vec3<f32>(v) + vec3<f32>(along) * t;
    for (var k = 0u; k < 3u; k++) {
        vertices[6u * number + k] = place[k];
        vertices[6u * number + 3u + k] = normal[k];
    }
}
