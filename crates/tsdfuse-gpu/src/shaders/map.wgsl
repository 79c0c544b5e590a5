// The map on the device: block table, blocks, state. The code of the pool of voxels is generated, with one binding per page.
// See map.rs for the layout, and for what happens when the map is full.

const BLOCK_VOXELS: u32 = 512u;
const WEIGHT_SCALE: f32 = 32768.0;
const NONE: u32 = 0xffffffffu;
// The table counts as full if a block finds no place within this many entries.
const MAX_PROBES: u32 = 64u;
// Flags.
const TABLE_FULL: u32 = 1u;
const POOL_FULL: u32 = 2u;

// A block without its voxels.
struct Block {
    index: vec3<i32>,
    // The last scan that updated it.
    stamp: atomic<u32>,
}

struct State {
    // While any flag is set, scans change nothing.
    flags: atomic<u32>,
    // Blocks in the pool.
    blocks: atomic<u32>,
    // Counters of the scan: blocks updated, returns fused, and returns not fused, by reason.
    updated: atomic<u32>,
    fused: atomic<u32>,
    outside_grid: atomic<u32>,
    without_normal: atomic<u32>,
    without_weight: atomic<u32>,
    outside_image: atomic<u32>,
    hidden: atomic<u32>,
    // Updates whose block does not exist: always 0.
    lost: atomic<u32>,
    // Whether a voxel may exceed the largest weight now.
    heavy: atomic<u32>,
    // The number of entries of the table, a power of two, minus 1.
    table_mask: u32,
    // How many blocks fit into the pool.
    capacity: u32,
    // The blocks that the scan updated: their coordinates and slots.
    list: array<vec4<i32>>,
}

// Four words per entry: the block's coordinates, with the highest bit flipped so that 0 means empty, and its slot plus 1.
@group(0) @binding(0) var<storage, read_write> table: array<atomic<u32>>;
@group(0) @binding(1) var<storage, read_write> blocks: array<Block>;
@group(0) @binding(2) var<storage, read_write> state: State;

// (5.1)
fn hash(b: vec3<i32>) -> u32 {
    let v = vec3<u32>(b);
    return v.x * 73856093u ^ v.y * 19349669u ^ v.z * 83492791u;
}

fn key(b: vec3<i32>) -> vec3<u32> {
    return vec3<u32>(b) ^ vec3<u32>(0x80000000u);
}

// Sets an empty word of the table. Returns 0 if the word has another value, 1 if it had this value before, 2 if it was set now.
fn claim(word: u32, value: u32) -> u32 {
    loop {
        let old = atomicLoad(&table[word]);
        if old == value {
            return 1u;
        }
        if old != 0u {
            return 0u;
        }
        if atomicCompareExchangeWeak(&table[word], 0u, value).exchanged {
            return 2u;
        }
    }
    return 0u;
}

struct Entry {
    // Its first word, or NONE if the table is full.
    word: u32,
    is_new: bool,
}

// The entry of a block, created if it does not exist. A word is set once and never changes, so a thread that finds another value goes
// on to the next entry, and so does every thread with the same block. The thread that sets the last word has created the entry. No
// locks are needed.
fn insert(block: vec3<i32>) -> Entry {
    let k = key(block);
    var entry = hash(block) & state.table_mask;
    for (var n = 0u; n < MAX_PROBES; n++) {
        let word = 4u * entry;
        if claim(word, k.x) != 0u && claim(word + 1u, k.y) != 0u {
            let last = claim(word + 2u, k.z);
            if last != 0u {
                return Entry(word, last == 2u);
            }
        }
        entry = (entry + 1u) & state.table_mask;
    }
    atomicOr(&state.flags, TABLE_FULL);
    return Entry(NONE, false);
}

// The slot of a block, or NONE. Must not run while blocks are created.
fn slot_of(block: vec3<i32>) -> u32 {
    let k = key(block);
    var entry = hash(block) & state.table_mask;
    for (var n = 0u; n < MAX_PROBES; n++) {
        let word = 4u * entry;
        let x = atomicLoad(&table[word]);
        if x == 0u {
            return NONE;
        }
        if x == k.x && atomicLoad(&table[word + 1u]) == k.y && atomicLoad(&table[word + 2u]) == k.z {
            return atomicLoad(&table[word + 3u]) - 1u;
        }
        entry = (entry + 1u) & state.table_mask;
    }
    return NONE;
}

// Lists a block that the scan updated. It must not be listed yet.
fn list_update(slot: u32) {
    state.list[atomicAdd(&state.updated, 1u)] = vec4(blocks[slot].index, i32(slot));
}

// Creates a block if it does not exist.
fn allocate(block: vec3<i32>) {
    let entry = insert(block);
    if !entry.is_new {
        return;
    }
    let slot = atomicAdd(&state.blocks, 1u);
    if slot >= state.capacity {
        atomicOr(&state.flags, POOL_FULL);
        return;
    }
    blocks[slot].index = block;
    atomicStore(&table[entry.word + 3u], slot + 1u);
}
