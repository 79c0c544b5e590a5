//! Several pictures in one, which is grey if all of them are.

use tsdfuse::render::{Image, Pixels};

/// The colour of pixels that show nothing.
pub(super) const BACKGROUND: [u8; 3] = [255; 3];

/// Pictures of one size side by side, `across` in a row. Pictures that are not in colour stay white.
pub fn sheet(pictures: &[&Image], across: usize) -> Image {
    let (width, height) = pictures.first().map_or((0, 0), |first| (first.width, first.height));
    let across = across.clamp(1, pictures.len().max(1));
    let rows = pictures.len().div_ceil(across);
    let mut pixels = vec![BACKGROUND; across * width * rows * height];
    for (number, picture) in pictures.iter().enumerate() {
        let Pixels::Rgb(from) = &picture.pixels else { continue };
        let corner = number / across * height * across * width + number % across * width;
        if (picture.width, picture.height) == (width, height) && width > 0 {
            for (row, line) in from.chunks(width).enumerate() {
                pixels[corner + row * across * width..][..width].copy_from_slice(line);
            }
        }
    }
    // Grey needs a third of the bytes.
    let pixels = if pixels.iter().all(|[r, g, b]| r == g && g == b) {
        Pixels::Grey(pixels.iter().map(|pixel| pixel[0]).collect())
    } else {
        Pixels::Rgb(pixels)
    };
    Image {
        width: across * width,
        height: rows * height,
        pixels,
    }
}
