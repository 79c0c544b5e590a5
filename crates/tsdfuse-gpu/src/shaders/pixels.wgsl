// Images in which the nearest return of a pixel stays: depth images and cylindrical ones.

// Row by row, how deep the nearest return of each pixel is, metres: all bits are flipped, so that the least wins by `atomicMax`, and
// 0 is none. Then what a method notes beside these.
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

// Offers a return to its pixel, or NONE, and counts those that another one hides.
fn offer(pixel: u32, depth: f32) {
    if pixel == NONE {
        atomicAdd(&outside_image, 1u);
    } else if atomicMax(&pixels[pixel], ~bitcast<u32>(depth)) != 0u {
        atomicAdd(&hidden, 1u);
    }
}

// Tells what a workgroup counted.
fn tell_offers(lane: u32) {
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&state.outside_image, atomicLoad(&outside_image));
        atomicAdd(&state.hidden, atomicLoad(&hidden));
    }
}
