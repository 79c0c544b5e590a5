// Finding the surface, the first step of meshing and rendering.
//
// A word for each row of each block (voxels along x at some y and z): three bits for each voxel, whether the grid edges
// from it along x, y and z have a vertex (bits 3x + axis), and above them, eight bits for the cells with surface. A cell is
// the cube between eight neighbouring voxel centres; only cells observed at all corners count. See `tsdfuse::mesh`.

struct Surface {
    // Blocks in the map.
    blocks: u32,
    // Voxels with a smaller weight sum count as never observed.
    min_sum: u32,
    // The part of the mesh that is written: its first block in the list, the number of blocks, its first vertex and triangle.
    first: u32,
    count: u32,
    first_vertex: u32,
    first_triangle: u32,
}

@group(1) @binding(0) var<uniform> surface: Surface;
// 27 slots per block: that of the block at offset (x, y, z) − 1 has number x + 3y + 9z.
@group(1) @binding(1) var<storage, read_write> neighbours: array<u32>;
// 64 rows per block, number y + 8z.
@group(1) @binding(2) var<storage, read_write> rows: array<u32>;
// The numbers of vertices and triangles of each block.
@group(1) @binding(3) var<storage, read_write> counts: array<vec2<u32>>;
// The cases of marching cubes: the number of triangles, and their edges, four bits each.
@group(1) @binding(4) var<storage, read> cases: array<vec3<u32>>;

const EDGES: u32 = 0x00ffffffu;

// The slots of the workgroup's block and its neighbours.
var<workgroup> near: array<u32, 27>;

// The number of a voxel's block among these, and the voxel's number in it, from its coordinates relative to the first voxel of the
// workgroup's block, −8..16.
fn block_number(v: vec3<i32>) -> u32 {
    let b = vec3<u32>((v >> vec3(3u)) + 1);
    return b.x + 3u * b.y + 9u * b.z;
}

fn local_number(v: vec3<i32>) -> u32 {
    let l = vec3<u32>(v & vec3(7));
    return l.x | l.y << 3u | l.z << 6u;
}

fn voxel_of(slot: u32, v: vec3<i32>) -> vec2<u32> {
    if slot == NONE {
        return vec2(0u);
    }
    return load_voxel(slot, local_number(v));
}

// F of a voxel; above 1 if it was not observed.
const UNOBSERVED: f32 = 4.0;

fn distance_of(voxel: vec2<u32>) -> f32 {
    return select(UNOBSERVED, f32(bitcast<i32>(voxel.y)) / f32(voxel.x), voxel.x >= surface.min_sum);
}

// The derivative of F along an axis, per voxel: the central difference where both sides are observed.
fn derivative(before: f32, here: f32, after: f32) -> f32 {
    let low = before < UNOBSERVED;
    let high = after < UNOBSERVED;
    if low && high {
        return 0.5 * (after - before);
    }
    return select(select(0.0, after - here, high), here - before, low);
}
