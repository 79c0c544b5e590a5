//! Rasters as GeoTIFF (OGC 19-008r4): 32-bit numbers with their place in the world, as QGIS and GDAL read them.

use std::io::{self, Cursor};
use std::path::Path;

use tiff::encoder::colortype::{ColorType, Gray32Float};
use tiff::encoder::{Compression, DeflateLevel, TiffEncoder};
use tiff::tags::{PhotometricInterpretation, SampleFormat, Tag};
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
    put::<Gray32Float>(path.as_ref(), raster, &raster.values, epsg, &[])
}

/// Writes several rasters of the same cells as the bands of one file, with their names. Otherwise as [`write()`].
///
/// # Errors
/// As [`write()`]; `InvalidInput` if the rasters have other cells.
pub fn write_layers<const N: usize>(
    path: impl AsRef<Path>,
    layers: &[(&str, &Raster); N],
    epsg: Option<u16>,
) -> Result<()> {
    let path = path.as_ref();
    let shape = |raster: &Raster| (raster.low, raster.cell_m, raster.width, raster.height);
    let Some((_, first)) = layers.first() else {
        return Err(Error::dataset(path, "a file without layers"));
    };
    if layers.iter().any(|(_, other)| shape(other) != shape(first)) {
        return Err(Error::dataset(path, "layers of a file have the same cells"));
    }
    let values: Vec<f32> = (0..first.values.len())
        .flat_map(|at| layers.iter().map(move |(_, layer)| layer.values[at]))
        .collect();
    put::<Bands<N>>(path, first, &values, epsg, &layers.map(|(name, _)| name))
}

/// N numbers in each cell.
struct Bands<const N: usize>;

impl<const N: usize> ColorType for Bands<N> {
    type Inner = f32;
    const TIFF_VALUE: PhotometricInterpretation = PhotometricInterpretation::BlackIsZero;
    const BITS_PER_SAMPLE: &'static [u16] = &[32; N];
    const SAMPLE_FORMAT: &'static [SampleFormat] = &[SampleFormat::IEEEFP; N];

    fn horizontal_predict(row: &[f32], result: &mut Vec<f32>) {
        result.extend_from_slice(row); // no predictor is asked for
    }
}

/// The names of bands, as GDAL writes them.
fn metadata(names: &[&str]) -> String {
    let item = |(i, name): (usize, &&str)| {
        format!("<Item name=\"DESCRIPTION\" sample=\"{i}\" role=\"description\">{name}</Item>")
    };
    let items: String = names.iter().enumerate().map(item).collect();
    format!("<GDALMetadata>{items}</GDALMetadata>")
}

/// GDAL's names of bands.
const GDAL_METADATA: u16 = 42_112;

fn put<C: ColorType<Inner = f32>>(
    path: &Path,
    raster: &Raster,
    values: &[f32],
    epsg: Option<u16>,
    names: &[&str],
) -> Result<()> {
    let bytes = encode::<C>(raster, values, epsg, names).map_err(Error::io(path))?;
    crate::atomic::write(path, |out| io::Write::write_all(out, &bytes))
}

fn encode<C: ColorType<Inner = f32>>(
    raster: &Raster,
    values: &[f32],
    epsg: Option<u16>,
    names: &[&str],
) -> io::Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let edge = |n: usize| u32::try_from(n).map_err(|e| io::Error::new(io::ErrorKind::InvalidInput, e));
    let (width, height) = (edge(raster.width)?, edge(raster.height)?);
    let mut encode = || -> tiff::TiffResult<()> {
        let mut encoder = TiffEncoder::new(&mut bytes)?.with_compression(Compression::Deflate(DeflateLevel::Balanced));
        let mut image = encoder.new_image::<C>(width, height)?;
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
        if names.len() > 1 {
            // What the others are is said by their names alone.
            tags.write_tag(Tag::ExtraSamples, &vec![0_u16; names.len() - 1][..])?;
            tags.write_tag(Tag::Unknown(GDAL_METADATA), &*metadata(names))?;
        }
        image.write_data(values)
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
    fn layers_are_bands_with_names() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tif");
        let layer = |first: f32| Raster {
            low: DVec2::ZERO,
            cell_m: 0.5,
            width: 2,
            height: 1,
            values: vec![first, first + 1.0],
        };
        let (a, b, c) = (layer(0.0), layer(10.0), layer(20.0));
        write_layers(&path, &[("elevation", &a), ("slope", &b), ("step", &c)], None).unwrap();
        let mut decoder = Decoder::new(std::fs::File::open(&path).unwrap()).unwrap();
        let DecodingResult::F32(values) = decoder.read_image().unwrap() else {
            panic!("not f32")
        };
        assert_eq!(values, [0.0, 10.0, 20.0, 1.0, 11.0, 21.0]);
        let told = decoder.get_tag_ascii_string(Tag::Unknown(GDAL_METADATA)).unwrap();
        assert!(told.contains("sample=\"1\" role=\"description\">slope<"), "{told}");
        let other = Raster {
            width: 1,
            height: 2,
            ..layer(0.0)
        };
        assert!(write_layers(&path, &[("a", &a), ("b", &other)], None).is_err());
    }

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
