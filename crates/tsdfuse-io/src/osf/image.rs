//! The images of OSF: counts of 8, 16, 24 or 32 bits a pixel.

use std::io::Read;

use png::{BitDepth, ColorType};

/// What a ZPNG begins with.
pub(super) const ZPNG: [u8; 2] = [0xF8, 0xFB];

/// A PNG: counts are in grey, or the lowest byte first in red, green, blue and alpha.
pub(super) fn png(image: &[u8], rows: usize, columns: usize) -> Result<Vec<u32>, String> {
    let limits = png::Limits { bytes: 1 << 26 };
    let mut decoder = png::Decoder::new_with_limits(std::io::Cursor::new(image), limits);
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(|e| format!("a field is no PNG: {e}"))?;
    let info = reader.info();
    check(info.width as usize, info.height as usize, rows, columns)?;
    let (bytes, is_big) = match (info.color_type, info.bit_depth) {
        (ColorType::Grayscale, BitDepth::Eight) => (1, false),
        (ColorType::Grayscale, BitDepth::Sixteen) => (2, true),
        (ColorType::Rgb, BitDepth::Eight) => (3, false),
        (ColorType::Rgba, BitDepth::Eight) => (4, false),
        kind => return Err(format!("a field has pixels of an unknown kind: {kind:?}")),
    };
    let mut pixels = vec![0; rows * columns * bytes];
    reader
        .next_frame(&mut pixels)
        .map_err(|e| format!("a field cannot be read: {e}"))?;
    if is_big {
        pixels.chunks_exact_mut(2).for_each(<[u8]>::reverse);
    }
    Ok(counts(&pixels, bytes))
}

/// A ZPNG (Taylor's): differences along rows, of four bytes also between them and one plane after the other, packed by Zstandard.
pub(super) fn zpng(image: &[u8], rows: usize, columns: usize) -> Result<Vec<u32>, String> {
    let head = image.first_chunk::<8>().ok_or("a field has no header")?;
    let u16_at = |at: usize| usize::from(u16::from_le_bytes([head[at], head[at + 1]]));
    check(u16_at(2), u16_at(4), rows, columns)?;
    let bytes = usize::from(head[6]) * usize::from(head[7]);
    if ![1, 2, 4].contains(&bytes) {
        return Err(format!("a field has pixels of {bytes} bytes"));
    }
    let mut packed = &image[8..];
    let decoder = ruzstd::decoding::StreamingDecoder::new(&mut packed);
    let decoder = decoder.map_err(|e| format!("a field cannot be unpacked: {e}"))?;
    let size = rows * columns * bytes;
    let mut filtered = Vec::new();
    let read = decoder.take(size as u64).read_to_end(&mut filtered);
    read.map_err(|e| format!("a field cannot be unpacked: {e}"))?;
    if filtered.len() != size {
        return Err(format!("a field has {} bytes, not {size}", filtered.len()));
    }
    let plane = rows * columns;
    let mut pixels = vec![0_u8; size];
    for row in 0..rows {
        let mut before = [0_u8; 4];
        for pixel in row * columns..(row + 1) * columns {
            let step = match bytes {
                // y, u and v of the colours' differences: blue, green − blue, green − red.
                4 => {
                    let [y, u, v, a] = [0, 1, 2, 3].map(|i| filtered[pixel + i * plane]);
                    let green = u.wrapping_add(y);
                    [green.wrapping_sub(v), green, y, a]
                }
                2 => [filtered[2 * pixel], filtered[2 * pixel + 1], 0, 0],
                _ => [filtered[pixel], 0, 0, 0],
            };
            before
                .iter_mut()
                .zip(step)
                .for_each(|(value, step)| *value = value.wrapping_add(step));
            pixels[pixel * bytes..(pixel + 1) * bytes].copy_from_slice(&before[..bytes]);
        }
    }
    Ok(counts(&pixels, bytes))
}

fn check(width: usize, height: usize, rows: usize, columns: usize) -> Result<(), String> {
    if (width, height) == (columns, rows) {
        return Ok(());
    }
    Err(format!("a field has {width} x {height} pixels, not {columns} x {rows}"))
}

/// Counts of so many bytes, the lowest first.
fn counts(pixels: &[u8], bytes: usize) -> Vec<u32> {
    let count = |pixel: &[u8]| pixel.iter().rev().fold(0, |count, &byte| count << 8 | u32::from(byte));
    pixels.chunks_exact(bytes).map(count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the SDK writes of older profiles: pictures of each depth.
    #[test]
    fn counts_are_read_from_pictures_of_any_depth() {
        for (color, depth, bytes) in [
            (ColorType::Grayscale, BitDepth::Eight, 1),
            (ColorType::Grayscale, BitDepth::Sixteen, 2),
            (ColorType::Rgb, BitDepth::Eight, 3),
            (ColorType::Rgba, BitDepth::Eight, 4),
        ] {
            let mask = if bytes == 4 { u32::MAX } else { (1 << (8 * bytes)) - 1 };
            let want: Vec<u32> = (0..6_u32).map(|i| i.wrapping_mul(0x1234_5679) & mask).collect();
            let mut pixels: Vec<u8> = want.iter().flat_map(|v| v.to_le_bytes()[..bytes].to_vec()).collect();
            if bytes == 2 {
                pixels.chunks_exact_mut(2).for_each(<[u8]>::reverse);
            }
            let mut image = Vec::new();
            let mut encoder = png::Encoder::new(&mut image, 3, 2);
            encoder.set_color(color);
            encoder.set_depth(depth);
            encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
            assert_eq!(png(&image, 2, 3), Ok(want));
            assert!(png(&image, 3, 2).unwrap_err().contains("3 x 2 pixels, not 2 x 3"));
        }
        assert!(png(b"no", 1, 1).is_err() && zpng(b"\xF8\xFB", 1, 1).is_err());
        assert!(
            zpng(&[0xF8, 0xFB, 1, 0, 1, 0, 9, 9, 1, 2, 3], 1, 1)
                .unwrap_err()
                .contains("81 bytes")
        );
    }
}
