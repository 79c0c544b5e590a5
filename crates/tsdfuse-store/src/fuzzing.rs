//! Feeds stores of arbitrary bytes, for the target in `fuzz/`. Not part of the library's interface.

use std::path::Path;

use tsdfuse::VoxelMap;
use tsdfuse::mesh::{self, MeshConfig};
use tsdfuse_io::fuzzing::with_group_checksums;

use crate::file::HEADERS;
use crate::format::{HEADER, INDEX_HEADER, Index, PAGE, REGION_HEADER, REGION_MARK, crc32};
use crate::{PagedMap, Salvage, StoreError};

/// A memory limit that has to evict.
const LITTLE: Option<usize> = Some(1 << 20);

/// A store, read, recovered and written, as it is and with correct checksums. `path` is a file that is overwritten.
///
/// # Panics
/// If what can be read cannot be recovered, is not the same, or cannot be committed.
pub fn store(path: &Path, bytes: &[u8]) {
    for bytes in [bytes.to_vec(), with_checksums(bytes)] {
        if std::fs::write(path, &bytes).is_err() {
            continue;
        }
        let read = PagedMap::open_read_only(path, LITTLE).and_then(|(map, _)| whole(map));
        if let Ok(salvage) = Salvage::scan(path) {
            let recovered = salvage.map().ok();
            assert!(recovered.is_some(), "what is intact makes a map");
            if let Ok(map) = &read {
                assert!(salvage.damage().places.is_empty(), "{:?}", salvage.damage());
                assert!(recovered.as_ref() == Some(map), "what is read is recovered");
            }
            if let Some(map) = recovered {
                let _ = mesh::extract(&map);
            }
        } else {
            assert!(read.is_err(), "what is read is recovered");
        }
        if let Ok(map) = read {
            let again = PagedMap::open(path, LITTLE).and_then(|(mut map, _)| map.commit(b"again"));
            let again = again.and_then(|()| PagedMap::open_read_only(path, LITTLE));
            let again = again.and_then(|(map, checkpoint)| Ok((whole(map)?, checkpoint)));
            assert!(
                again.is_ok_and(|again| again == (map, b"again".to_vec())),
                "what is read is committed"
            );
        }
    }
}

/// All blocks of a map, which is meshed on the way.
fn whole(mut paged: PagedMap) -> Result<VoxelMap, StoreError> {
    let wrong = |path: &Path| {
        let path = path.to_owned();
        move |reason| StoreError::Map { path, reason }
    };
    let path = paged.path().to_owned();
    let mut map = VoxelMap::new(*paged.config()).map_err(wrong(&path))?;
    map.set_integrations(paged.integrations());
    paged.for_each_region(|part, region| {
        let mut blocks = part.blocks_of(region);
        blocks.try_for_each(|(index, block)| map.insert_block(index, block.clone()).map_err(wrong(&path)))
    })?;
    let mut surface = paged.surface(&MeshConfig::default());
    for cube in surface.cubes() {
        surface.pieces(cube).map_err(StoreError::from_io)?.for_each(drop);
    }
    Ok(map)
}

/// A file whose headers, indices, regions and groups of blocks have the checksums that fit their bytes.
fn with_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for at in HEADERS {
        let header = bytes.get_mut(at as usize..).and_then(|rest| rest.get_mut(..HEADER));
        if let Some((header, checksum)) = header.and_then(|header| header.split_last_chunk_mut()) {
            *checksum = crc32(&[header]).to_le_bytes();
        }
    }
    for at in (0..bytes.len()).step_by(PAGE as usize) {
        let record = &mut bytes[at..];
        if record.starts_with(&REGION_MARK) && record.len() >= REGION_HEADER {
            let (header, packed) = record.split_at_mut(REGION_HEADER);
            let (fields, checksum) = header.split_at_mut(REGION_HEADER - 4);
            let length = u32::from_le_bytes(fields[fields.len() - 4..].try_into().unwrap_or_default()) as usize;
            if let Some(packed) = packed.get_mut(..length) {
                with_group_checksums(packed);
                checksum.copy_from_slice(&crc32(&[fields, packed]).to_le_bytes());
            }
        } else if Index::begins(record) && record.len() >= INDEX_HEADER {
            let length = Index::length(record)
                .ok()
                .and_then(|length| usize::try_from(length).ok());
            let index = length.and_then(|length| record.get_mut(..length));
            if let Some((index, checksum)) = index.and_then(|index| index.split_last_chunk_mut()) {
                *checksum = crc32(&[index]).to_le_bytes();
            }
        }
    }
    bytes
}
