// The organized image of a scan: which laser measured which return at which firing. The cells are those of `tsdfuse::sensor::image`,
// ring by ring; columns wrap around.

struct Cell {
    // In world axes relative to the anchor, metres.
    point: vec3<f32>,
    // The return; INVALID if it cannot be placed, NONE if there is none.
    i: u32,
}

// The cell of a return.
struct Place {
    // In columns; negative if the return has none.
    azimuth: f32,
    // Or NONE.
    cell: u32,
}

// The returns that want a cell. All bits are flipped, so that the least value wins by `atomicMax`, and 0 means none.
struct Offer {
    // The distance of the nearest return from the cell's centre, columns.
    off: atomic<u32>,
    // The first return at that distance, and the first that would move here from a neighbouring cell.
    nearest: atomic<u32>,
    aside: atomic<u32>,
}

@group(1) @binding(2) var<storage, read_write> cells: array<Cell>;
@group(1) @binding(3) var<storage, read_write> places: array<Place>;
@group(1) @binding(4) var<storage, read_write> offers: array<Offer>;

const INVALID: u32 = 0xfffffffeu;

// The cell of a return, or NONE.
fn cell_of(i: u32) -> u32 {
    return places[i].cell;
}

// Whether a cell holds a return that can be placed.
fn is_there(cell: Cell) -> bool {
    return cell.i < INVALID;
}

// The columns beside a column.
fn next_column(column: u32) -> u32 {
    return select(column + 1u, 0u, column + 1u == frame.columns);
}

fn column_before(column: u32) -> u32 {
    return select(column, frame.columns, column == 0u) - 1u;
}

// The start of the ray of a cell's return.
fn origin_of(cell: Cell) -> vec3<f32> {
    if frame.times_at == 0u {
        return vec3(0.0);
    }
    let secs = time_of(cell.i);
    return shift_at(segment_at(secs), secs);
}

// Two rings per word.
fn ring_of(i: u32) -> u32 {
    return returns[frame.rings_at + i / 2u] >> (16u * (i & 1u)) & 0xffffu;
}

@compute @workgroup_size(64)
fn find_azimuths(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        let p = point_of(i);
        let ring = ring_of(i);
        places[i] = Place(-1.0, NONE);
        if ring >= frame.rings || !is_finite(bitcast<vec3<u32>>(p)) || all(p == vec3(0.0)) {
            continue;
        }
        let column = -arc_tangent2(p.y, p.x) * frame.columns_per_rad;
        let azimuth = select(column, column + f32(frame.columns), column < 0.0);
        places[i].azimuth = azimuth;
        atomicAdd(&rings[ring].bins[bin_of(azimuth)], 1u);
    }
}

@compute @workgroup_size(64)
fn find_phases(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var ring = id.x; ring < frame.rings; ring += 64u * groups.x) {
        rings[ring].phase = mean_phase(ring);
    }
}

// The cell that a return wants.
struct Wish {
    ring: u32,
    // May be one past the last at the end of a turn.
    column: u32,
    cell: u32,
    // The return's offset from the cell's centre, in columns.
    off: f32,
}

fn wish_of(i: u32) -> Wish {
    let ring = ring_of(i);
    let shifted = places[i].azimuth - rings[ring].phase;
    let column = u32(shifted + 0.5);
    let cell = ring * frame.columns + select(0u, column, column < frame.columns);
    return Wish(ring, column, cell, shifted - f32(column));
}

fn has_azimuth(i: u32) -> bool {
    return places[i].azimuth >= 0.0;
}

// Each cell goes to the return nearest to its centre, …
@compute @workgroup_size(64)
fn offer_cells(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        if has_azimuth(i) {
            let wish = wish_of(i);
            atomicMax(&offers[wish.cell].off, ~bitcast<u32>(abs(wish.off)));
        }
    }
}

// … or to the first of several; …
@compute @workgroup_size(64)
fn choose_nearest(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        if has_azimuth(i) {
            let wish = wish_of(i);
            if atomicLoad(&offers[wish.cell].off) == ~bitcast<u32>(abs(wish.off)) {
                atomicMax(&offers[wish.cell].nearest, ~i);
            }
        }
    }
}

// … the others move to the neighbouring cell on their side, if that is empty and they come from another firing.
@compute @workgroup_size(64)
fn move_aside(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < frame.total; i += 64u * groups.x) {
        if !has_azimuth(i) {
            continue;
        }
        let wish = wish_of(i);
        let winner = ~atomicLoad(&offers[wish.cell].nearest);
        if winner == i {
            continue;
        }
        let side = select(wish.column + frame.columns - 1u, wish.column + 1u, wish.off > 0.0) % frame.columns;
        let free = wish.ring * frame.columns + side;
        let apart = abs(places[winner].azimuth - places[i].azimuth);
        if atomicLoad(&offers[free].nearest) == 0u && min(apart, f32(frame.columns) - apart) > SAME_FIRING {
            atomicMax(&offers[free].aside, ~i);
        }
    }
}

// Fills and places all cells.
@compute @workgroup_size(64)
fn place_cells(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var cell = id.x; cell < frame.rings * frame.columns; cell += 64u * groups.x) {
        let nearest = atomicLoad(&offers[cell].nearest);
        // ~0 equals NONE.
        let i = ~select(nearest, atomicLoad(&offers[cell].aside), nearest == 0u);
        if i == NONE {
            cells[cell].i = NONE;
            continue;
        }
        places[i].cell = cell;
        if is_valid(i) {
            cells[cell] = Cell(place(i).point, i);
        } else {
            cells[cell].i = INVALID;
        }
    }
}
