// Finds the surface in each block.

// Rows of 10 voxels at −1 … 8 of each axis: bit x + 1 of row (y + 1) + 10 (z + 1).
const RIM: i32 = 10;
var<workgroup> observed: array<u32, 100>;
var<workgroup> negative: array<u32, 100>;
var<workgroup> totals: array<atomic<u32>, 2>;

fn row_at(y: i32, z: i32) -> i32 {
    return (y + 1) + RIM * (z + 1);
}

// The cells of a row whose corners are all observed: bit x + 1.
fn cells(y: i32, z: i32) -> u32 {
    let r = row_at(y, z);
    let all = observed[r] & observed[r + 1] & observed[r + RIM] & observed[r + RIM + 1];
    return all & (all >> 1u);
}

// The bits of eight voxels, three apart.
fn spread(bits: u32) -> u32 {
    var out = 0u;
    for (var x = 0u; x < 8u; x++) {
        out |= (bits >> x & 1u) << (3u * x);
    }
    return out;
}

// The case of a cell: bit c for each corner c behind the surface.
fn case_of(x: u32, y: i32, z: i32) -> u32 {
    let r = row_at(y, z);
    let at = x + 1u;
    return (negative[r] >> at & 3u) | (negative[r + 1] >> at & 3u) << 2u
        | (negative[r + RIM] >> at & 3u) << 4u | (negative[r + RIM + 1] >> at & 3u) << 6u;
}

@compute @workgroup_size(64)
fn find_surface(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var slot = group.x; slot < surface.blocks; slot += groups.x) {
        if lane < 27u {
            let n = vec3<i32>(vec3(lane % 3u, lane / 3u % 3u, lane / 9u)) - 1;
            let found = slot_of(blocks[slot].index + n);
            near[lane] = found;
            neighbours[27u * slot + lane] = found;
        }
        if lane < 2u {
            atomicStore(&totals[lane], 0u);
        }
        workgroupBarrier();
        for (var r = i32(lane); r < RIM * RIM; r += 64) {
            let at = vec2(r % RIM - 1, r / RIM - 1);
            var seen = 0u;
            var behind = 0u;
            for (var x = -1; x <= 8; x++) {
                let v = vec3(x, at);
                let voxel = voxel_of(near[block_number(v)], v);
                if voxel.x >= surface.min_sum {
                    seen |= 1u << u32(x + 1);
                    behind |= (voxel.y >> 31u) << u32(x + 1);
                }
            }
            observed[r] = seen;
            negative[r] = behind;
        }
        workgroupBarrier();

        let y = i32(lane & 7u);
        let z = i32(lane >> 3u);
        let r = row_at(y, z);
        let own = cells(y, z);
        let left = cells(y - 1, z);
        let below = cells(y, z - 1);
        // A vertex needs a cell next to its edge, and the edge's ends on different sides of the surface.
        let about_x = own | left | below | cells(y - 1, z - 1);
        let about_y = (own | below) | (own | below) << 1u;
        let about_z = (own | left) | (own | left) << 1u;
        let n = negative[r];
        let along_x = about_x & (n ^ (n >> 1u)) & observed[r] & observed[r] >> 1u;
        let along_y = about_y & (n ^ negative[r + 1]) & observed[r] & observed[r + 1];
        let along_z = about_z & (n ^ negative[r + RIM]) & observed[r] & observed[r + RIM];
        let edges = spread(along_x >> 1u & 255u) | spread(along_y >> 1u & 255u) << 1u | spread(along_z >> 1u & 255u) << 2u;
        let any = n | negative[r + 1] | negative[r + RIM] | negative[r + RIM + 1];
        let every = n & negative[r + 1] & negative[r + RIM] & negative[r + RIM + 1];
        let crossed = (own & (any | any >> 1u) & ~(every & every >> 1u)) >> 1u & 255u;
        rows[64u * slot + lane] = edges | crossed << 24u;
        var triangles = 0u;
        for (var x = 0u; x < 8u; x++) {
            if (crossed >> x & 1u) == 1u {
                triangles += cases[case_of(x, y, z)].x;
            }
        }
        atomicAdd(&totals[0], countOneBits(edges));
        atomicAdd(&totals[1], triangles);
        workgroupBarrier();
        if lane == 0u {
            counts[slot] = vec2(atomicLoad(&totals[0]), atomicLoad(&totals[1]));
        }
        workgroupBarrier();
    }
}
