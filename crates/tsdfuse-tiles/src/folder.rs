//! A folder that is complete or not there.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use crate::error::{Result, TilesError};

/// Finds out before the work whether tiles can be written for this `…/tileset.json`; tells their folder.
///
/// # Errors
/// [`TilesError::Folder`] if it is no folder of their own: one that is not there yet, or is empty.
pub fn check(tileset: &Path) -> Result<&Path> {
    let wrong = |path: &Path, reason: &str| TilesError::Folder {
        path: path.to_owned(),
        reason: reason.to_owned(),
    };
    let folder = tileset.parent().filter(|folder| folder.file_name().is_some());
    let folder = folder.ok_or_else(|| {
        wrong(
            tileset,
            "tiles are written into a folder of their own: NAME/tileset.json",
        )
    })?;
    match fs::read_dir(folder) {
        Ok(mut entries) => match entries.next() {
            None => Ok(folder),
            Some(_) => Err(wrong(
                folder,
                "is not empty; tiles are written into a folder of their own",
            )),
        },
        Err(e) if e.kind() == ErrorKind::NotFound => {
            let above = folder.parent().filter(|above| !above.as_os_str().is_empty());
            match above.unwrap_or(Path::new(".")) {
                above if above.is_dir() => Ok(folder),
                above => Err(wrong(folder, &format!("there is no folder {}", above.display()))),
            }
        }
        Err(e) => Err(wrong(folder, &e.to_string())),
    }
}

/// A folder in the making, beside the one that it becomes; gone unless it is finished.
#[derive(Debug)]
pub(crate) struct Folder<'a> {
    path: PathBuf,
    target: &'a Path,
}

impl<'a> Folder<'a> {
    pub(crate) fn begin(target: &'a Path) -> Result<Self> {
        let name = target.file_name().unwrap_or_default().to_string_lossy();
        let mut attempt = 0;
        loop {
            let path = target.with_file_name(format!(".{name}.{}-{attempt}.tmp", std::process::id()));
            match fs::create_dir(&path) {
                Ok(()) => return Ok(Self { path, target }),
                Err(e) if e.kind() == ErrorKind::AlreadyExists && attempt < 1000 => attempt += 1,
                Err(e) => return Err(wrong(target, &e)),
            }
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The bytes of all its files.
    pub(crate) fn bytes(&self) -> Result<u64> {
        let sizes = || {
            fs::read_dir(&self.path)?
                .map(|entry| Ok(entry?.metadata()?.len()))
                .sum()
        };
        let sizes: io::Result<u64> = sizes();
        sizes.map_err(|e| wrong(self.target, &e))
    }

    /// Gives it its name.
    pub(crate) fn finish(self) -> Result<()> {
        let replace = || {
            match fs::remove_dir(self.target) {
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(e),
                _ => {}
            }
            fs::rename(&self.path, self.target)
        };
        replace().map_err(|e| wrong(self.target, &e))
    }
}

impl Drop for Folder<'_> {
    fn drop(&mut self) {
        // Nothing to remove once it has its name.
        let _ = fs::remove_dir_all(&self.path);
    }
}

fn wrong(path: &Path, error: &io::Error) -> TilesError {
    TilesError::Folder {
        path: path.to_owned(),
        reason: error.to_string(),
    }
}
