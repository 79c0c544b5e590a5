// The phases of the lasers, that is by how much their columns are turned, from histograms. See `tsdfuse::sensor::image`.

struct Ring {
    // The numbers of returns by their place within a column.
    bins: array<atomic<u32>, PHASE_BINS>,
    // Their circular mean, in columns.
    phase: f32,
}

@group(1) @binding(5) var<storage, read_write> rings: array<Ring>;

// The bin of an azimuth, given in columns and not negative.
fn bin_of(azimuth: f32) -> u32 {
    return u32(azimuth * f32(PHASE_BINS)) % PHASE_BINS;
}

// cos((k + ½)·π/16); PHASE_BINS is 32.
const COSINES = array(0.9951847, 0.95694035, 0.8819213, 0.77301043, 0.6343933, 0.47139674, 0.29028466, 0.09801714);

// The number of returns of a bin, minus that of the bin half a column further on.
fn more_than_opposite(ring: u32, bin: u32) -> i32 {
    let opposite = (bin + PHASE_BINS / 2u) % PHASE_BINS;
    return i32(atomicLoad(&rings[ring].bins[bin])) - i32(atomicLoad(&rings[ring].bins[opposite]));
}

// The phase of a ring. The counts of bins with equal cosines are added as integers, so that they cancel exactly.
fn mean_phase(ring: u32) -> f32 {
    var sum = vec2(0.0);
    for (var k = 0u; k < 8u; k++) {
        let a = more_than_opposite(ring, k);
        let b = more_than_opposite(ring, 15u - k);
        sum += vec2(f32(a - b) * COSINES[k], f32(a + b) * COSINES[7u - k]);
    }
    return arc_tangent2(sum.y, sum.x) / (2.0 * PI);
}
