//! Writes pictures as PNG files. [`crate::rgbd`] reads depth images.

use std::io::{self, Write};
use std::path::Path;

use png::{BitDepth, ColorType, Encoder};
use tsdfuse::render::{Image, Pixels};

use crate::atomic;
use crate::error::{Error, Result};

/// Writes a picture; the file appears when it is complete.
///
/// # Errors
/// Names the file and what the system says; also for other extensions than `.png`.
pub fn write(path: impl AsRef<Path>, image: &Image) -> Result<()> {
    check(&path)?;
    atomic::write(path, |file| write_to(file, image))
}

/// Checks that [`write()`] accepts this path, so that a wrong extension is reported before the work is done.
///
/// # Errors
/// Names the file.
pub fn check(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        Ok(())
    } else {
        Err(Error::dataset(path, "a picture is written as .png"))
    }
}

/// Encodes a picture as a PNG file in memory.
///
/// # Errors
/// The picture is wider or higher than PNG can store, or the number of its pixels is not width times height.
pub fn encode(image: &Image) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write_to(&mut bytes, image).map_err(Error::io("a picture"))?;
    Ok(bytes)
}

fn write_to(out: impl Write, image: &Image) -> io::Result<()> {
    let edge = |n: usize| u32::try_from(n).map_err(|_| io::Error::other("more pixels in a row than PNG can count"));
    let mut encoder = Encoder::new(out, edge(image.width)?, edge(image.height)?);
    let wide: Vec<u8>;
    let (color, depth, bytes) = match &image.pixels {
        Pixels::Grey(grey) => (ColorType::Grayscale, BitDepth::Eight, grey.as_slice()),
        Pixels::Rgb(colors) => (ColorType::Rgb, BitDepth::Eight, colors.as_flattened()),
        Pixels::Grey16(numbers) => {
            wide = numbers.iter().flat_map(|n| n.to_be_bytes()).collect();
            (ColorType::Grayscale, BitDepth::Sixteen, wide.as_slice())
        }
    };
    encoder.set_color(color);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_read_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.PNG");
        let numbers = vec![0, 1, 255, 256, 40_000, 65_535];
        for (pixels, color, depth, bytes) in [
            (
                Pixels::Grey(vec![0, 7, 255, 1, 2, 3]),
                ColorType::Grayscale,
                BitDepth::Eight,
                vec![0, 7, 255, 1, 2, 3],
            ),
            (
                Pixels::Rgb(vec![[1, 2, 3]; 6]),
                ColorType::Rgb,
                BitDepth::Eight,
                [1, 2, 3].repeat(6),
            ),
            (
                Pixels::Grey16(numbers.clone()),
                ColorType::Grayscale,
                BitDepth::Sixteen,
                numbers.iter().flat_map(|n: &u16| n.to_be_bytes()).collect(),
            ),
        ] {
            let image = Image {
                width: 3,
                height: 2,
                pixels,
            };
            write(&path, &image).unwrap();
            assert_eq!(encode(&image).unwrap(), std::fs::read(&path).unwrap());
            let file = io::BufReader::new(std::fs::File::open(&path).unwrap());
            let mut reader = png::Decoder::new(file).read_info().unwrap();
            let mut read = vec![0; reader.output_buffer_size().unwrap()];
            let info = reader.next_frame(&mut read).unwrap();
            assert_eq!(
                (info.width, info.height, info.color_type, info.bit_depth),
                (3, 2, color, depth)
            );
            assert_eq!(read[..info.buffer_size()], bytes);
        }
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let image = Image {
            width: 2,
            height: 1,
            pixels: Pixels::Grey(vec![0; 2]),
        };
        let told = write(dir.path().join("a.jpg"), &image).unwrap_err().to_string();
        assert!(told.ends_with("a.jpg: a picture is written as .png"), "{told}");
        let short = Image {
            pixels: Pixels::Grey(vec![0; 1]),
            ..image
        };
        assert!(write(dir.path().join("a.png"), &short).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
