//! Cells: cubes of regions, which a map too large for one machine is divided into. Each is a file of its own.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use glam::IVec3;
use pyo3::prelude::*;
use rayon::prelude::*;
use serde::Serialize;
use tsdfuse::VoxelMap;
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse_io::map_file::Writer;

use crate::data::to_python;
use crate::error::OrRaise;
use crate::map::Map;
use crate::reach::{REGION_SHIFT, cell_of, check_edge, key};

/// A cell that was written.
#[derive(Debug, Serialize)]
struct Written {
    cell: [i32; 3],
    blocks: usize,
    /// CRC-32 of each file, hexadecimal.
    checksum: String,
    skin_checksum: Option<String>,
}

/// Hands bytes on, and sums them up.
struct Summed<W> {
    out: W,
    sum: crc32fast::Hasher,
}

impl<W: Write> Write for Summed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.sum.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn hexadecimal(sum: u32) -> String {
    format!("{sum:08x}")
}

/// The checksum of a file (CRC-32, hexadecimal).
#[pyfunction]
pub(crate) fn checksum(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let sum = py.detach(|| {
        let mut file = File::open(&path)?;
        let mut sum = crc32fast::Hasher::new();
        let mut bytes = vec![0; 1 << 18];
        loop {
            match file.read(&mut bytes)? {
                0 => return Ok(sum.finalize()),
                read => sum.update(&bytes[..read]),
            }
        }
    });
    Ok(hexadecimal(sum.map_err(tsdfuse_io::Error::io(&path)).or_raise()?))
}

/// Writes the blocks of some regions that are wanted, as a saved map; how many there were, and the file's checksum.
fn write(
    map: &VoxelMap,
    regions: &[RegionIndex],
    path: &Path,
    wanted: impl Fn(BlockIndex) -> bool,
) -> Result<(usize, String), tsdfuse_io::Error> {
    let (mut blocks, mut sum) = (0, 0);
    tsdfuse_io::atomic::write(path, |out| {
        let out = Summed {
            out,
            sum: crc32fast::Hasher::new(),
        };
        let mut writer = Writer::new(out, map.config(), map.integrations())?;
        for &region in regions {
            for (index, block) in map.blocks_of(region).filter(|(index, _)| wanted(*index)) {
                writer.block(index, block)?;
                blocks += 1;
            }
        }
        sum = writer.finish()?.sum.finalize();
        Ok(())
    })?;
    Ok((blocks, hexadecimal(sum)))
}

/// Writes a map cell by cell, `FOLDER/X_Y_Z.tsdf`. With `skin`, the outermost blocks of each cell, which its neighbours need for their
/// meshes, are not in there but in a file of their own, `FOLDER/X_Y_Z.skin`: a cell is both.
#[pyfunction]
#[pyo3(signature = (map, folder, edge, *, skin=false))]
pub(crate) fn write_cells<'py>(
    py: Python<'py>,
    map: &Map,
    folder: PathBuf,
    edge: i32,
    skin: bool,
) -> PyResult<Bound<'py, PyAny>> {
    check_edge(edge)?;
    let written = py.detach(|| {
        let content = map.read();
        let map = &content.map;
        let mut cells: BTreeMap<[i32; 3], (IVec3, Vec<RegionIndex>)> = BTreeMap::new();
        for region in map.regions() {
            let cell = cell_of(region, edge);
            cells
                .entry(key(cell))
                .or_insert_with(|| (cell, Vec::new()))
                .1
                .push(region);
        }
        let of_cell = |(cell, regions): &(IVec3, Vec<RegionIndex>)| {
            let path = folder.join(format!("{}_{}_{}.tsdf", cell.x, cell.y, cell.z));
            let first = (*cell * edge) << REGION_SHIFT;
            let last = first + (edge << REGION_SHIFT) - 1;
            let is_outermost = |BlockIndex(b): BlockIndex| b.cmpeq(first).any() || b.cmpeq(last).any();
            let (mut blocks, checksum) = write(map, regions, &path, |block| !skin || !is_outermost(block))?;
            let mut skin_checksum = None;
            if skin {
                let (outermost, sum) = write(map, regions, &path.with_extension("skin"), is_outermost)?;
                blocks += outermost;
                skin_checksum = Some(sum);
            }
            Ok(Written {
                cell: cell.to_array(),
                blocks,
                checksum,
                skin_checksum,
            })
        };
        let cells: Vec<_> = cells.into_values().collect();
        cells
            .par_iter()
            .map(of_cell)
            .collect::<Result<Vec<_>, tsdfuse_io::Error>>()
            .or_raise()
    })?;
    to_python(py, &written)
}

#[cfg(feature = "tiles")]
mod tiles {
    use std::io;
    use std::path::PathBuf;

    use pyo3::prelude::*;
    use tsdfuse::VoxelMap;
    use tsdfuse::index::RegionIndex;
    use tsdfuse::mesh::{MeshConfig, RegionSource, Surface};

    use crate::data::to_python;
    use crate::error::OrRaise;
    use crate::map::Map;
    use crate::reach::{cell_of, check_edge};

    /// A cell, with the blocks around it: only its own regions have surface of their own.
    #[derive(Debug)]
    struct Cell<'a> {
        map: &'a VoxelMap,
        regions: Vec<RegionIndex>,
    }

    impl RegionSource for Cell<'_> {
        fn map(&self) -> &VoxelMap {
            self.map
        }

        fn regions(&self) -> Vec<RegionIndex> {
            self.regions.clone()
        }

        fn load(&mut self, _: &[RegionIndex]) -> io::Result<bool> {
            Ok(false)
        }
    }

    #[pymethods]
    impl Map {
        /// Writes the surface of one cell as 3D Tiles; the map also holds the outermost blocks of the cells around it.
        #[pyo3(signature = (cell, edge, path, *, min_weight=None))]
        fn write_cell_tiles<'py>(
            &self,
            py: Python<'py>,
            cell: [i32; 3],
            edge: i32,
            path: PathBuf,
            min_weight: Option<f32>,
        ) -> PyResult<Bound<'py, PyAny>> {
            check_edge(edge)?;
            let config = MeshConfig {
                min_weight: min_weight.unwrap_or(MeshConfig::default().min_weight),
            };
            config.validate().or_raise()?;
            let written = py.detach(|| {
                let content = self.read();
                let mut regions = content.map.regions();
                regions.retain(|&region| cell_of(region, edge).to_array() == cell);
                let source = Cell {
                    map: &content.map,
                    regions,
                };
                tsdfuse_tiles::write(&path, &mut Surface::new(source, &config)).or_raise()
            })?;
            to_python(py, &written)
        }
    }
}
