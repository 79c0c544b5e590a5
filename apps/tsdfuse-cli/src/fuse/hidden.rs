//! The store of a run that wants none but for its memory: hidden beside the result, and gone afterwards.

use std::fs;
use std::path::{Path, PathBuf};

use crate::output::is_tileset;
use crate::progress::note;

/// How such a store's name ends.
const ENDING: &str = ".store";

/// Where the store of this process is, beside a result.
pub(super) fn hidden_store(result: &Path) -> PathBuf {
    // The folder of tiles is not there yet.
    let result = result.parent().filter(|_| is_tileset(result)).unwrap_or(result);
    let name = result.file_name().unwrap_or_default().to_string_lossy();
    result.with_file_name(format!(".{name}.{}{ENDING}", std::process::id()))
}

/// A file that is removed in the end.
pub(super) struct Removed(pub(super) PathBuf);

impl Drop for Removed {
    fn drop(&mut self) {
        // It is of no use to anybody.
        let _ = fs::remove_file(&self.0);
    }
}

/// Removes what runs that were killed left beside a result: hidden stores that no process has open.
pub(super) fn remove_stale(store: &Path) {
    let folder = store.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = fs::read_dir(folder.unwrap_or(Path::new(".")));
    for path in entries.into_iter().flatten().flatten().map(|entry| entry.path()) {
        if is_hidden_store(&path) && tsdfuse_store::remove_unused(&path) {
            let path = path.display();
            note(format_args!(
                "{path}: was left by a run that was killed, and is removed"
            ));
        }
    }
}

/// Whether a file is called `.NAME.PID.store`.
fn is_hidden_store(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let middle = name.strip_prefix('.').and_then(|name| name.strip_suffix(ENDING));
    let pid = middle.and_then(|middle| middle.rsplit_once('.'));
    pid.is_some_and(|(name, pid)| !name.is_empty() && pid.parse::<u32>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::{MapConfig, VoxelMap};
    use tsdfuse_store::{Options, Pager};

    #[test]
    fn only_stores_of_killed_runs_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let map = VoxelMap::new(MapConfig::default()).unwrap();
        let store =
            |name: &str| Pager::create(dir.path().join(name), &map, b"", Options { limit_bytes: 1 << 20 }).unwrap();
        let others = [
            ".a.ply.8.store",
            "a.ply.7.store",
            ".a.store",
            ".a.ply.x.store",
            ".b.ply.9.store",
        ];
        let left = |names: &[&str]| names.iter().filter(|name| dir.path().join(name).exists()).count();
        drop(store(".a.ply.7.store"));
        let used = store(others[0]);
        others[1..4].iter().for_each(|name| drop(store(name)));
        fs::write(dir.path().join(others[4]), b"redb it is not").unwrap();
        let own = hidden_store(&dir.path().join("c.ply"));
        remove_stale(&own);
        assert_eq!((left(&[".a.ply.7.store"]), left(&others)), (0, 5));
        drop(used);
        remove_stale(&own);
        assert_eq!((left(&others[..1]), left(&others)), (0, 4));
        assert!(is_hidden_store(&own));
    }

    #[test]
    fn the_store_of_tiles_is_not_in_their_folder() {
        let name = format!(".drive.{}.store", std::process::id());
        assert_eq!(
            hidden_store(Path::new("a/drive/tileset.json")),
            Path::new("a").join(name)
        );
    }
}
