// Maintenance of the map, after a scan and after it has grown.

// Limits the weights of the blocks that the scan updated, like `Voxel::limit`. Workgroups loop over blocks. There is hardly ever
// anything to do.
@compute @workgroup_size(64)
fn limit_weights(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if atomicLoad(&state.flags) != 0u || atomicLoad(&state.heavy) == 0u {
        return;
    }
    let count = atomicLoad(&state.updated);
    for (var n = group.x; n < count; n += groups.x) {
        let slot = u32(state.list[n].w);
        for (var local = lane; local < BLOCK_VOXELS; local += 64u) {
            let voxel = load_voxel(slot, local);
            if voxel.x > frame.max_weight_sum {
                store_voxel(slot, local, limited(voxel, frame.max_weight_sum));
            }
        }
    }
}

// The weight `max_sum` with the same F: distance · max_sum / weight, rounded towards zero. The product needs 62 bits, so the division
// goes bit by bit.
fn limited(voxel: vec2<u32>, max_sum: u32) -> vec2<u32> {
    let distance = bitcast<i32>(voxel.y);
    let factor = u32(abs(distance)); // at most the weight, which is below 2³¹
    var quotient = 0u;
    var rest = 0u;
    for (var bit = 0u; bit < 32u; bit++) {
        quotient *= 2u;
        rest *= 2u;
        if rest >= voxel.x {
            rest -= voxel.x;
            quotient += 1u;
        }
        if (max_sum >> (31u - bit) & 1u) == 1u {
            rest += factor;
            if rest >= voxel.x {
                rest -= voxel.x;
                quotient += 1u;
            }
        }
    }
    return vec2(max_sum, bitcast<u32>(select(i32(quotient), -i32(quotient), distance < 0)));
}

// Enters all blocks into an empty table.
@compute @workgroup_size(64)
fn fill_table(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&state.blocks), state.capacity);
    for (var slot = id.x; slot < count; slot += 64u * groups.x) {
        let entry = insert(blocks[slot].index);
        if entry.word != NONE {
            atomicStore(&table[entry.word + 3u], slot + 1u);
        }
    }
}
