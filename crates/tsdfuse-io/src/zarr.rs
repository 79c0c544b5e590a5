//! [Zarr](https://zarr.dev), version 3: the voxels of a map as chunked arrays, for `xarray.open_zarr` and `zarr.open`.
//!
//! | array | type and shape | what |
//! |---|---|---|
//! | `distance_m` | f4 (z, y, x) | signed distance, positive on the sensor's side, at most `truncation_m`; NaN where nothing was observed |
//! | `weight` | f4 (z, y, x) | W; 0 where nothing was observed |
//! | `x`, `y`, `z` | f8 | where the centres of voxels are in the world, metres |
//!
//! `voxel_size_m` and `truncation_m` are attributes of the group. Each chunk is a region of the map, 64³ voxels, compressed with gzip.
//! The arrays span the bounding box of all regions, but regions without observed voxels have no chunk. So arrays may be far larger than
//! memory or disk; only the chunks that are asked for are read.

use std::iter::zip;
use std::path::Path;
use std::sync::Arc;

use tsdfuse::MapConfig;
use tsdfuse::glam::IVec3;
use tsdfuse::index::{BLOCK_EDGE, BlockIndex, RegionIndex};
use tsdfuse::map::Block;
use zarrs::array::codec::GzipCodec;
use zarrs::array::{Array, ArrayBuilder, ArrayMetadataOptions, data_type};
use zarrs::filesystem::FilesystemStore;
use zarrs::group::GroupBuilder;

use crate::atomic::Folder;
use crate::error::{Error, Result};

/// Voxels along the edge of a region, which is a chunk.
const CHUNK: usize = 64;

/// The longest side of the arrays, in voxels: 800 km of 5 cm.
const MOST: u64 = 1 << 24;

/// Arrays in the making. Regions may be written in any order and by several threads; the folder appears when it is finished.
#[derive(Debug)]
pub struct Volume<'a> {
    target: &'a Path,
    folder: Folder<'a>,
    distances: Array<FilesystemStore>,
    weights: Array<FilesystemStore>,
    /// The region of the first chunk.
    first: IVec3,
    truncation_m: f32,
}

impl<'a> Volume<'a> {
    /// Begins the arrays of a map with these regions in a new folder.
    ///
    /// # Errors
    /// As [`Folder::begin`]; also if there are no regions, or they are too far apart.
    pub fn create(target: &'a Path, config: &MapConfig, regions: &[RegionIndex]) -> Result<Self> {
        let all = || regions.iter().map(|region| region.0);
        let (Some(first), Some(last)) = (all().reduce(IVec3::min), all().reduce(IVec3::max)) else {
            return Err(Error::dataset(target, "the map is empty"));
        };
        let shape = (last.as_i64vec3() - first.as_i64vec3() + 1).as_u64vec3() * CHUNK as u64;
        if shape.max_element() > MOST {
            let [x, y, z] = shape.to_array();
            let reason = format!("a box of {x} x {y} x {z} voxels is too large for arrays: crop the map");
            return Err(Error::dataset(target, reason));
        }
        let folder = Folder::begin(target)?;
        let arrays = || -> Result<[Array<FilesystemStore>; 2], Box<dyn std::error::Error>> {
            let store = Arc::new(FilesystemStore::new(folder.path())?);
            let mut group = GroupBuilder::new().build(store.clone(), "/")?;
            let attributes = [
                ("voxel_size_m", config.voxel_size_m),
                ("truncation_m", config.truncation_m),
            ];
            for (name, value) in attributes {
                group.attributes_mut().insert(name.to_owned(), value.into());
            }
            group.store_metadata()?;

            let first_voxel = first.as_dvec3() * CHUNK as f64;
            for (axis, (length, first)) in zip(["x", "y", "z"], zip(shape.to_array(), first_voxel.to_array())) {
                let mut array = ArrayBuilder::new(vec![length], vec![length], data_type::float64(), 0.0_f64);
                array.dimension_names(Some([axis]));
                array.attributes_mut().insert("units".to_owned(), "m".into());
                let array = array.build(store.clone(), &format!("/{axis}"))?;
                array.store_metadata_opt(&plain())?;
                let center_m = |i| (first + i as f64 + 0.5) * config.voxel_size_m;
                array.store_chunk(&[0], (0..length).map(center_m).collect::<Vec<f64>>())?;
            }

            let array = |name: &str, nothing: f32| -> Result<_, Box<dyn std::error::Error>> {
                let shape = [shape.z, shape.y, shape.x].to_vec();
                let mut array = ArrayBuilder::new(shape, vec![CHUNK as u64; 3], data_type::float32(), nothing);
                array.dimension_names(Some(["z", "y", "x"]));
                array.bytes_to_bytes_codecs(vec![Arc::new(GzipCodec::new(1)?)]);
                let array = array.build(store.clone(), &format!("/{name}"))?;
                array.store_metadata_opt(&plain())?;
                Ok(array)
            };
            Ok([array("distance_m", f32::NAN)?, array("weight", 0.0)?])
        };
        let [distances, weights] = arrays().map_err(|e| Error::dataset(target, e.to_string()))?;
        Ok(Self {
            target,
            folder,
            distances,
            weights,
            first,
            truncation_m: config.truncation_m as f32,
        })
    }

    /// Writes a region with its blocks.
    ///
    /// # Errors
    /// Names the folder and what the system says.
    pub fn region<'b>(&self, region: RegionIndex, blocks: impl Iterator<Item = (BlockIndex, &'b Block)>) -> Result<()> {
        let mut distances_m = vec![f32::NAN; CHUNK.pow(3)];
        let mut weights = vec![0.0; CHUNK.pow(3)];
        for (BlockIndex(block), Block { voxels }) in blocks {
            let at = (block - 8 * region.0).as_usizevec3() * BLOCK_EDGE as usize;
            for (row, voxels) in voxels.chunks_exact(BLOCK_EDGE as usize).enumerate() {
                let (y, z) = (at.y + row % 8, at.z + row / 8);
                for (i, voxel) in ((z * CHUNK + y) * CHUNK + at.x..).zip(voxels) {
                    if let Some(distance) = voxel.distance() {
                        distances_m[i] = distance * self.truncation_m;
                        weights[i] = voxel.weight();
                    }
                }
            }
        }
        let [x, y, z] = (region.0 - self.first).as_u64vec3().to_array();
        let store = |array: &Array<_>, values| array.store_chunk(&[z, y, x], values);
        let stored = rayon::join(|| store(&self.distances, distances_m), || store(&self.weights, weights));
        stored
            .0
            .and(stored.1)
            .map_err(|e| Error::dataset(self.target, e.to_string()))
    }

    /// Renames the folder to its final name.
    ///
    /// # Errors
    /// As [`Folder::finish`].
    pub fn finish(self) -> Result<()> {
        self.folder.finish()
    }
}

/// Nothing about the program that wrote an array.
fn plain() -> ArrayMetadataOptions {
    ArrayMetadataOptions::default().with_include_zarrs_metadata(false)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tsdfuse::VoxelMap;
    use tsdfuse::map::Voxel;

    use super::*;

    fn read<T: zarrs::array::ElementOwned>(folder: &Path, name: &str, from: [u64; 3], rank: usize) -> Vec<T> {
        let store = Arc::new(FilesystemStore::new(folder).unwrap());
        let array = Array::open(store, &format!("/{name}")).unwrap();
        let cube: Vec<_> = from[..rank].iter().map(|&i| i..i + 2).collect();
        array.retrieve_array_subset(&cube.as_slice()).unwrap()
    }

    #[test]
    fn voxels_are_where_their_coordinates_say() {
        let mut map = VoxelMap::new(MapConfig::default()).unwrap();
        let mut block = Block::EMPTY;
        // x + 8 y + 64 z
        for (i, distance_sum) in [(7 + 8 * 6 + 64 * 5, -32_768), (6 + 8 * 6 + 64 * 5, 16_384)] {
            block.voxels[i] = Voxel {
                weight_sum: 65_536,
                distance_sum,
            };
        }
        map.insert_block(BlockIndex(IVec3::new(-1, 2, 9)), block).unwrap();
        map.insert_block(BlockIndex(IVec3::new(17, -8, 0)), Block::EMPTY)
            .unwrap();
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("map.zarr");
        let volume = Volume::create(&folder, map.config(), &map.regions()).unwrap();
        for region in map.regions() {
            volume.region(region, map.blocks_of(region)).unwrap();
        }
        volume.finish().unwrap();
        // From (-64, -64, 0), four regions by two by two.
        let (x, y, z) = (64 - 8 + 6, 64 + 16 + 6, 72 + 5);
        let distances: Vec<f32> = read(&folder, "distance_m", [z, y, x], 3);
        assert_eq!(distances[..2], [0.05, -0.1]);
        assert!(distances[2..].iter().all(|d| d.is_nan()));
        assert_eq!(
            read::<f32>(&folder, "weight", [z, y, x], 3),
            [2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        );
        for (axis, i, voxel) in [("x", x, -2.0), ("y", y, 22.0), ("z", z, 77.0)] {
            let centers_m: Vec<f64> = read(&folder, axis, [i, 0, 0], 1);
            assert_eq!(centers_m, [voxel, voxel + 1.0].map(|i| (i + 0.5) * 0.05), "{axis}");
        }
        // Of sixteen chunks, that with something in it.
        let chunks = |name: &str| walk(&folder.join(name).join("c"));
        assert_eq!((chunks("distance_m"), chunks("weight")), (1, 1));
    }

    fn walk(folder: &Path) -> usize {
        let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        entries.map(|path| if path.is_dir() { walk(&path) } else { 1 }).sum()
    }

    #[test]
    fn what_makes_no_arrays_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let refused = |regions: &[IVec3]| {
            let regions: Vec<_> = regions.iter().copied().map(RegionIndex).collect();
            let folder = dir.path().join("map.zarr");
            let volume = Volume::create(&folder, &MapConfig::default(), &regions);
            volume.unwrap_err().to_string()
        };
        assert!(refused(&[]).ends_with("map.zarr: the map is empty"));
        let far = refused(&[IVec3::splat(-(1 << 25)), IVec3::splat((1 << 25) - 1)]);
        assert!(
            far.ends_with("4294967296 x 4294967296 x 4294967296 voxels is too large for arrays: crop the map"),
            "{far}"
        );
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
