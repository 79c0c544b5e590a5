// Which links between returns the map holds already: see `tsdfuse::patch::held`.

// Whether the map's surface at a patch has settled.
fn is_held(surface: Patch) -> bool {
    let center = frame.anchor_fraction + surface.center * frame.voxels_per_m;
    if !all(abs(center) < vec3(MAX_REACH)) {
        return false;
    }
    let index = frame.anchor_voxel + vec3<i32>(floor(center));
    let slot = slot_of(index >> vec3(3u));
    if slot == NONE {
        return false;
    }
    let at = vec3<u32>(index & vec3(7));
    let voxel = load_voxel(slot, at.x | at.y << 3u | at.z << 6u);
    let weight = f32(voxel.x);
    let off = frame.truncation_vox * abs(f32(bitcast<i32>(voxel.y)));
    return weight > SETTLED * WEIGHT_SCALE * weight_of(surface) && off <= OTHER_SURFACE * weight;
}

@compute @workgroup_size(64)
fn find_held(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var cell = id.x; cell < frame.rings * frame.columns; cell += 64u * groups.x) {
        if patches[cell].kind == NOWHERE {
            continue;
        }
        var held = 0u;
        for (var towards = 1u; towards <= 2u; towards++) {
            let l = link_from(cell, towards);
            var k = 1.0;
            while l.steps > f32(LONG) && k < l.steps && is_held(on_the_way(l, k)) {
                k += 1.0;
            }
            held |= select(0u, towards, k > 1.0 && k == l.steps);
        }
        patches[cell].held = held;
    }
}
