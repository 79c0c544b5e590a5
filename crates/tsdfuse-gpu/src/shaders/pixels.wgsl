// Images that keep the nearest return of each pixel: depth images and cylindrical ones.

// The depth of the nearest return of each pixel, row by row, metres. All bits are flipped, so that the least value wins by `atomicMax`,
// and 0 means none. Further values of the method follow.
@group(1) @binding(4) var<storage, read_write> pixels: array<atomic<u32>>;

fn pixel_count() -> u32 {
    return frame.rings * frame.columns;
}

// The bits of the depth of a pixel; NONE if it has none.
fn depth_bits(pixel: u32) -> u32 {
    return ~atomicLoad(&pixels[pixel]);
}

var<workgroup> hidden: atomic<u32>;
var<workgroup> outside_image: atomic<u32>;

// Offers a return to its pixel, or to NONE, and counts the returns that another one hides.
fn offer(pixel: u32, depth: f32) {
    if pixel == NONE {
        atomicAdd(&outside_image, 1u);
    } else if atomicMax(&pixels[pixel], ~bitcast<u32>(depth)) != 0u {
        atomicAdd(&hidden, 1u);
    }
}

// Adds the counters of a workgroup to the scan's.
fn tell_offers(lane: u32) {
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&state.outside_image, atomicLoad(&outside_image));
        atomicAdd(&state.hidden, atomicLoad(&hidden));
    }
}
