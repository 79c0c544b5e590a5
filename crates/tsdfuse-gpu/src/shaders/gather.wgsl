// Collects the voxels of chosen blocks: see gather.rs.

// The coordinates of each block; w is unused.
@group(1) @binding(0) var<storage, read> wanted: array<vec4<i32>>;
// For each of these blocks 1 if the map has it, else 0; then both sums of each of its voxels.
@group(1) @binding(1) var<storage, read_write> collected: array<u32>;

const WORDS_PER_BLOCK: u32 = 1u + 2u * BLOCK_VOXELS;

// One workgroup per block, in turns.
@compute @workgroup_size(64)
fn gather(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var n = group.x; n < arrayLength(&wanted); n += groups.x) {
        let slot = slot_of(wanted[n].xyz);
        let first = n * WORDS_PER_BLOCK;
        // A block that no scan updated was created by a scan that did not fit.
        if slot == NONE || atomicLoad(&blocks[slot].stamp) == 0u {
            collected[first] = 0u;
            continue;
        }
        collected[first] = 1u;
        for (var local = lane; local < BLOCK_VOXELS; local += 64u) {
            let voxel = load_voxel(slot, local);
            collected[first + 1u + 2u * local] = voxel.x;
            collected[first + 2u + 2u * local] = voxel.y;
        }
    }
}
