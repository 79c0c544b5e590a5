// The organized image: who is whose neighbour. Cells go ring by ring; columns wrap around.

struct Cell {
    // In world axes relative to the anchor, metres.
    point: vec3<f32>,
    // The return, or NONE.
    i: u32,
}

@group(1) @binding(2) var<storage, read_write> cells: array<Cell>;

// The cell of a return, or NONE.
fn cell_of(i: u32) -> u32 {
    return returns[frame.cells_at + i];
}

// From where the ray of a cell's return came.
fn origin_of(cell: Cell) -> vec3<f32> {
    if frame.times_at == 0u {
        return vec3(0.0);
    }
    return frame.velocity * bitcast<f32>(returns[frame.times_at + cell.i]);
}

// The tangent of the angle between a ring and the next.
fn ring_gap(ring: u32) -> f32 {
    return bitcast<f32>(returns[frame.gaps_at + ring]);
}

// Places the returns in all cells.
@compute @workgroup_size(64)
fn place_cells(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var cell = id.x; cell < frame.rings * frame.columns; cell += 64u * groups.x) {
        let i = returns[frame.image_at + cell];
        if i != NONE && is_valid(i) {
            cells[cell] = Cell(place(i).point, i);
        } else {
            cells[cell].i = NONE;
        }
    }
}
