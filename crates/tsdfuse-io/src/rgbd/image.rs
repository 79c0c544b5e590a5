//! Grey PNG images: depth images and masks.

use std::io::Cursor;
use std::path::Path;

use png::{BitDepth, ColorType, Decoder, DecodingError};
use tsdfuse::sensor::Pinhole;

use crate::error::{Error, Result};

/// The most pixels that a depth image may have, as many as 4096 x 4096. Depth cameras have a few million; a PNG of a few
/// megabytes can decode to hundreds of millions.
const MAX_PIXELS: u64 = 1 << 24;

/// How large all images of a data set are, and which file says so.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ImageSize {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// The file's name, for messages.
    pub(crate) by: String,
}

impl ImageSize {
    /// Reads the header of an image.
    ///
    /// # Errors
    /// Names the file: it is no PNG, or no depth camera has images of that size.
    pub(crate) fn read(path: &Path, bytes: &[u8]) -> Result<Self> {
        let mut decoder = decoder(path, bytes)?;
        let (width, height) = decoder.read_header_info().map_err(wrong(path))?.size();
        let (fx, fy, cx, cy) = (1.0, 1.0, 0.5 * width as f32, 0.5 * height as f32);
        let some_camera = Pinhole {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        };
        some_camera.check().map_err(|e| Error::format(path, e.to_string()))?;
        check_pixels(path, width, height)?;
        Ok(Self {
            width,
            height,
            by: crate::files::name(path),
        })
    }
}

/// The units of each pixel of a depth image, row by row.
///
/// # Errors
/// Names the file: not a whole grey PNG with 16 bits, or of another size.
pub(crate) fn depths(path: &Path, bytes: &[u8], size: &ImageSize) -> Result<Vec<u16>> {
    let (_, pixels) = decode(
        path,
        bytes,
        size,
        "a depth image is grey with 16 bits",
        &[BitDepth::Sixteen],
    )?;
    let values = pixels.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]]));
    Ok(values.collect())
}

/// Which pixels a mask shows, row by row: those that are not 0.
///
/// # Errors
/// Names the file: not a whole grey PNG with 1 to 8 bits, of another size, or nothing but zeros.
pub(crate) fn mask(path: &Path, bytes: &[u8], size: &ImageSize) -> Result<Vec<bool>> {
    use BitDepth::{Eight, Four, One, Two};
    let wanted = "a mask is grey with 1 or 8 bits";
    let (bits, pixels) = decode(path, bytes, size, wanted, &[One, Two, Four, Eight])?;
    let bits = u32::from(bits as u8);
    let ones = u8::MAX >> (8 - bits);
    // Each row begins with a new byte.
    let row_bytes = (size.width * bits).div_ceil(8) as usize;
    let rows = pixels.chunks_exact(row_bytes);
    let shown: Vec<bool> = rows
        .flat_map(|row| {
            let pixels = row.iter().flat_map(|byte| {
                let shifts = (0..8 / bits).rev().map(|i| i * bits);
                shifts.map(move |shift| byte >> shift & ones != 0)
            });
            pixels.take(size.width as usize)
        })
        .collect();
    if !shown.contains(&true) {
        return Err(Error::format(path, "masks every pixel: it holds nothing but zeros"));
    }
    Ok(shown)
}

/// The bytes of a grey image of one of the bit depths, in PNG's order. Memory is taken only after type and size are checked.
fn decode(
    path: &Path,
    bytes: &[u8],
    size: &ImageSize,
    wanted: &str,
    possible: &[BitDepth],
) -> Result<(BitDepth, Vec<u8>)> {
    let mut decoder = decoder(path, bytes)?;
    let header = decoder.read_header_info().map_err(wrong(path))?;
    let (color, bits) = (header.color_type, header.bit_depth);
    if !(color == ColorType::Grayscale && possible.contains(&bits)) {
        let is = match color {
            ColorType::Grayscale => "grey",
            ColorType::GrayscaleAlpha => "grey with transparency",
            ColorType::Rgb => "RGB",
            ColorType::Rgba => "RGB with transparency",
            ColorType::Indexed => "coloured by a palette",
        };
        let reason = format!("is {is} with {} bits; {wanted}", bits as u8);
        return Err(Error::format(path, reason));
    }
    let ImageSize { width, height, by } = size;
    if header.size() != (*width, *height) {
        let (is_width, is_height) = header.size();
        let reason = format!("is {is_width} x {is_height} pixels where {by} has {width} x {height}");
        return Err(Error::format(path, reason));
    }
    check_pixels(path, *width, *height)?;
    let row_bytes = (*width as usize * bits as usize).div_ceil(8);
    let mut pixels = vec![0; row_bytes * *height as usize];
    let mut reader = decoder.read_info().map_err(wrong(path))?;
    let frame = reader.next_frame(&mut pixels).map_err(wrong(path))?;
    // The first picture of an animation may be but a part.
    if frame.buffer_size() != pixels.len() {
        return Err(Error::format(path, "is an animation"));
    }
    reader.finish().map_err(wrong(path))?;
    Ok((bits, pixels))
}

/// Refuses an image before memory is allocated for its pixels.
fn check_pixels(path: &Path, width: u32, height: u32) -> Result<()> {
    if u64::from(width) * u64::from(height) <= MAX_PIXELS {
        return Ok(());
    }
    let reason = format!("is {width} x {height} pixels; a depth image has at most {MAX_PIXELS}");
    Err(Error::format(path, reason))
}

fn decoder<'a>(path: &Path, bytes: &'a [u8]) -> Result<Decoder<Cursor<&'a [u8]>>> {
    let is = match bytes {
        [0x89, b'P', b'N', b'G', ..] => {
            let mut decoder = Decoder::new(Cursor::new(bytes));
            decoder.set_ignore_text_chunk(true);
            decoder.set_ignore_iccp_chunk(true);
            return Ok(decoder);
        }
        [] => "is empty",
        [0xff, 0xd8, ..] => "is a JPEG image, not PNG",
        _ => "is no PNG image",
    };
    Err(Error::format(path, is))
}

fn wrong(path: &Path) -> impl Fn(DecodingError) -> Error {
    move |error| {
        let reason = match error {
            DecodingError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => "is truncated".to_owned(),
            DecodingError::LimitsExceeded => "takes more memory than an image should".to_owned(),
            error => {
                let reason = error.to_string().replace('\n', " ");
                format!("is a damaged PNG: {}", reason.trim_end_matches('.'))
            }
        };
        Error::format(path, reason)
    }
}
