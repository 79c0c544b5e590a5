//! Rasters as GeoTIFF (OGC 19-008r4): 32-bit numbers with their place in the world, as QGIS and GDAL read them.

use std::io::{self, Cursor};
use std::path::Path;

use tiff::encoder::{Compression, DeflateLevel, TiffEncoder, colortype::Gray32Float};
use tiff::tags::Tag;
use tsdfuse::raster::Raster;

use crate::error::{Error, Result};

/// What stands for "nothing is known".
const NO_DATA: &str = "nan";

/// GeoTIFF's keys: the model's type (1: projected), the raster's (1: cells are areas), and the code of the projected system.
const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const CITATION: u16 = 1026;
const PROJECTED: u16 = 3072;
/// "User-defined", for worlds whose place on Earth nobody knows.
const USER_DEFINED: u16 = 32_767;

/// Whether a path asks for one: `.tif` or `.tiff`.
pub fn is_geotiff(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

/// Writes a level raster, whose u is east and v is north, in the projected coordinate system with this EPSG code (such as 32632,
/// UTM zone 32 north), if it is known. The file appears when it is complete.
///
/// # Errors
/// Names the file and what the system says; also for a raster of more than 4 GiB.
pub fn write(path: impl AsRef<Path>, raster: &Raster, epsg: Option<u16>) -> Result<()> {
    let path = path.as_ref();
    let bytes = encode(raster, epsg).map_err(Error::io(path))?;
    crate::atomic::write(path, |out| io::Write::write_all(out, &bytes))
}

fn encode(raster: &Raster, epsg: Option<u16>) -> io::Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let edge = |n: usize| u32::try_from(n).map_err(|e| io::Error::new(io::ErrorKind::InvalidInput, e));
    let (width, height) = (edge(raster.width)?, edge(raster.height)?);
    let mut encode = || -> tiff::TiffResult<()> {
        let mut encoder = TiffEncoder::new(&mut bytes)?.with_compression(Compression::Deflate(DeflateLevel::Balanced));
        let mut image = encoder.new_image::<Gray32Float>(width, height)?;
        let (cell, top) = (raster.cell_m, raster.low.y + raster.cell_m * raster.height as f64);
        let tags = image.encoder();
        tags.write_tag(Tag::ModelPixelScaleTag, &[cell, cell, 0.0][..])?;
        tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, raster.low.x, top, 0.0][..])?;
        let citation = "coordinates of the log|";
        let keys = match epsg {
            Some(code) => vec![
                1,
                1,
                0,
                3,
                MODEL_TYPE,
                0,
                1,
                1,
                RASTER_TYPE,
                0,
                1,
                1,
                PROJECTED,
                0,
                1,
                code,
            ],
            None => {
                let length = citation.len() as u16;
                tags.write_tag(Tag::GeoAsciiParamsTag, citation)?;
                let own = [MODEL_TYPE, 0, 1, USER_DEFINED, RASTER_TYPE, 0, 1, 1];
                [
                    &[1, 1, 0, 3][..],
                    &own,
                    &[CITATION, Tag::GeoAsciiParamsTag.to_u16(), length, 0],
                ]
                .concat()
            }
        };
        tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..])?;
        tags.write_tag(Tag::GdalNodata, NO_DATA)?;
        image.write_data(&raster.values)
    };
    encode().map_err(io::Error::other)?;
    Ok(bytes.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::decoder::{Decoder, DecodingResult};
    use tsdfuse::glam::DVec2;

    #[test]
    fn rasters_are_read_back_with_their_place() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tif");
        let raster = Raster {
            low: DVec2::new(691_000.25, 5_335_000.5),
            cell_m: 0.25,
            width: 3,
            height: 2,
            values: vec![1.5, f32::NAN, 3.0, 4.0, -5.0, 6.25],
        };
        for (epsg, code) in [(Some(32_632), 32_632), (None, 0)] {
            write(&path, &raster, epsg).unwrap();
            let mut decoder = Decoder::new(std::fs::File::open(&path).unwrap()).unwrap();
            assert_eq!(decoder.dimensions().unwrap(), (3, 2));
            let DecodingResult::F32(values) = decoder.read_image().unwrap() else {
                panic!("not f32")
            };
            assert_eq!(
                values.iter().map(|v| v.to_bits()).collect::<Vec<_>>(),
                raster.values.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
            );
            assert_eq!(
                decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap(),
                [0.25, 0.25, 0.0]
            );
            assert_eq!(
                decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap(),
                [0.0, 0.0, 0.0, 691_000.25, 5_335_001.0, 0.0]
            );
            let keys = decoder.get_tag_u32_vec(Tag::GeoKeyDirectoryTag).unwrap();
            assert_eq!((keys.len(), keys[3]), (16, 3));
            let told = keys
                .chunks_exact(4)
                .find(|key| key[0] == u32::from(PROJECTED))
                .map_or(0, |key| key[3]);
            assert_eq!(told, code);
        }
    }
}
