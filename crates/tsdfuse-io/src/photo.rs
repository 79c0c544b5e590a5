//! Images of cameras, decoded: JPEG and PNG.

use std::io::Cursor;
use std::path::Path;

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::error::{Error, Result};

/// Pixels of an image along an edge, at most: what a header claims beyond is refused.
const MOST_EDGE: usize = 1 << 14;

/// An image: sRGB, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Photo {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Its pixels.
    pub pixels: Vec<[u8; 3]>,
}

/// Decodes an image; `name` is for messages.
///
/// # Errors
/// Names the image and what is wrong with it.
pub fn decode(name: impl AsRef<Path>, bytes: &[u8]) -> Result<Photo> {
    let wrong = |reason: String| Error::format(name.as_ref(), reason);
    let photo = match bytes {
        [0xff, 0xd8, ..] => jpeg(bytes),
        [0x89, b'P', b'N', b'G', ..] => png(bytes),
        _ => Err("is neither JPEG nor PNG".to_owned()),
    };
    photo.map_err(wrong)
}

fn jpeg(bytes: &[u8]) -> Result<Photo, String> {
    let options = DecoderOptions::default()
        .set_max_width(MOST_EDGE)
        .set_max_height(MOST_EDGE)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions().ok_or("has no size")?;
    plausible(width, height, bytes.len(), JPEG_PIXELS)?;
    let pixels = decoder.decode().map_err(|error| error.to_string())?;
    whole(width, height, pixels.as_chunks().0.to_vec())
}

fn png(bytes: &[u8]) -> Result<Photo, String> {
    let told = |error: png::DecodingError| error.to_string();
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: 1 << 30 });
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(told)?;
    let size = reader.info();
    plausible(size.width as usize, size.height as usize, bytes.len(), PNG_PIXELS)?;
    let mut samples = vec![0; reader.output_buffer_size().ok_or("is too large")?];
    let info = reader.next_frame(&mut samples).map_err(told)?;
    samples.truncate(info.buffer_size());
    let pixels = match info.color_type.samples() {
        n @ (3 | 4) => samples
            .chunks_exact(n)
            .map(|pixel| [pixel[0], pixel[1], pixel[2]])
            .collect(),
        n => samples.chunks_exact(n).map(|pixel| [pixel[0]; 3]).collect(),
    };
    whole(info.width as usize, info.height as usize, pixels)
}

/// Pixels that a byte can hold: in JPEG, a block of 64 takes a bit at least, in PNG, deflate makes at most 1,032 bytes of one, and a
/// pixel may take a bit.
const JPEG_PIXELS: usize = 64 * 8;
/// See [`JPEG_PIXELS`].
const PNG_PIXELS: usize = 1032 * 8;

/// Refuses what a header claims and no file of so many bytes can hold, before there is memory for it.
fn plausible(width: usize, height: usize, bytes: usize, pixels_per_byte: usize) -> Result<(), String> {
    let is_possible = (1..=MOST_EDGE).contains(&width) && (1..=MOST_EDGE).contains(&height);
    if !is_possible || width * height > pixels_per_byte * bytes {
        return Err(format!("{bytes} bytes are no image of {width} x {height}"));
    }
    Ok(())
}

fn whole(width: usize, height: usize, pixels: Vec<[u8; 3]>) -> Result<Photo, String> {
    if width.max(height) > MOST_EDGE || pixels.len() != width * height {
        return Err(format!(
            "{} pixels are not an image of {width} x {height}",
            pixels.len()
        ));
    }
    Ok(Photo { width, height, pixels })
}

impl Photo {
    /// The colour at a place in pixels, linear between the middles of pixels; `None` outside of them.
    pub fn at(&self, u: f32, v: f32) -> Option<[f32; 3]> {
        let is_inside = u >= 0.0 && v >= 0.0 && u <= (self.width - 1) as f32 && v <= (self.height - 1) as f32;
        if !is_inside {
            return None;
        }
        let (x, y) = (
            (u as usize).min(self.width.saturating_sub(2)),
            (v as usize).min(self.height.saturating_sub(2)),
        );
        let (s, t) = (u - x as f32, v - y as f32);
        let pixel = |x: usize, y: usize| {
            self.pixels[y.min(self.height - 1) * self.width + x.min(self.width - 1)].map(f32::from)
        };
        let [a, b, c, d] = [pixel(x, y), pixel(x + 1, y), pixel(x, y + 1), pixel(x + 1, y + 1)];
        Some(std::array::from_fn(|i| {
            (a[i] * (1.0 - s) + b[i] * s) * (1.0 - t) + (c[i] * (1.0 - s) + d[i] * s) * t
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::render::{Image, Pixels};

    #[test]
    fn pngs_come_back_and_places_between_pixels_are_between_their_colours() {
        let pixels = vec![[0, 0, 0], [100, 0, 0], [0, 200, 0], [100, 200, 40]];
        let image = Image {
            width: 2,
            height: 2,
            pixels: Pixels::Rgb(pixels.clone()),
        };
        let photo = decode("a", &crate::png::encode(&image).unwrap()).unwrap();
        assert_eq!(photo.pixels, pixels);
        assert_eq!(photo.at(0.5, 0.5), Some([50.0, 100.0, 10.0]));
        assert_eq!(photo.at(1.0, 1.0), Some([100.0, 200.0, 40.0]));
        assert_eq!(photo.at(1.01, 0.0), None);
        let grey = Image {
            width: 2,
            height: 1,
            pixels: Pixels::Grey(vec![7, 9]),
        };
        assert_eq!(
            decode("a", &crate::png::encode(&grey).unwrap()).unwrap().pixels,
            [[7; 3], [9; 3]]
        );
    }

    /// A JPEG of 16 x 16 grey pixels, made by hand: one block of each quantisation, all coefficients 0.
    fn jpeg() -> Vec<u8> {
        let mut bytes = vec![0xff, 0xd8, 0xff, 0xdb, 0, 67, 0];
        bytes.extend([1; 64]);
        bytes.extend([0xff, 0xc0, 0, 11, 8, 0, 16, 0, 16, 1, 1, 0x11, 0]);
        // One code of one bit for each table: no difference, and the end of a block.
        for table in [0x00, 0x10] {
            bytes.extend([0xff, 0xc4, 0, 20, table, 1]);
            bytes.extend([0; 15]);
            bytes.push(0);
        }
        bytes.extend([0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0, 0x00, 0xff, 0xd9]);
        bytes
    }

    #[test]
    fn damaged_images_are_refused_or_decoded_but_never_more() {
        let image = Image {
            width: 9,
            height: 7,
            pixels: Pixels::Rgb((0..63).map(|i| [i, 255 - i, 3 * i]).collect()),
        };
        let png = crate::png::encode(&image).unwrap();
        assert_eq!(decode("a", &jpeg()).unwrap().pixels, [[128; 3]; 256]);
        for bytes in [jpeg(), png] {
            for len in 0..bytes.len() {
                let _ = decode("a", &bytes[..len]);
            }
            for at in 0..bytes.len() {
                for flip in [1, 0x80, 0xff] {
                    let mut damaged = bytes.clone();
                    damaged[at] ^= flip;
                    if let Ok(photo) = decode("a", &damaged) {
                        assert!(photo.pixels.len() == photo.width * photo.height && !photo.pixels.is_empty());
                    }
                }
            }
        }
    }

    #[test]
    fn a_size_that_no_such_file_has_takes_no_memory() {
        let mut large = jpeg();
        let at = large.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap() + 5;
        large[at..at + 4].copy_from_slice(&[0x3f, 0xff, 0x3f, 0xff]);
        let told = decode("a.jpg", &large).unwrap_err().to_string();
        assert!(told.contains("bytes are no image of 16383 x 16383"), "{told}");
        let image = Image {
            width: 4,
            height: 4,
            pixels: Pixels::Rgb(vec![[7; 3]; 16]),
        };
        let mut large = crate::png::encode(&image).unwrap();
        large[16..24].copy_from_slice(&[0, 0, 0x3f, 0xff, 0, 0, 0x3f, 0xff]);
        let crc = crc32fast::hash(&large[12..29]);
        large[29..33].copy_from_slice(&crc.to_be_bytes());
        let told = decode("a.png", &large).unwrap_err().to_string();
        assert!(told.contains("bytes are no image of 16383 x 16383"), "{told}");
    }

    #[test]
    fn what_is_no_image_is_refused() {
        for bytes in [
            &b""[..],
            b"GIF89a",
            &[0xff, 0xd8, 0xff],
            &[0xff, 0xd8, 0xff, 0xe0, 0, 2, 0xff, 0xd9],
            b"\x89PNG\r\n\x1a\n",
        ] {
            let told = decode("front/7.jpg", bytes).unwrap_err().to_string();
            assert!(told.starts_with("front/7.jpg: "), "{told}");
        }
    }
}
