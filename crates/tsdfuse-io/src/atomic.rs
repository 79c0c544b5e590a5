//! Output files and folders that are complete or not there.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Writes a file through `write`, so that at `path` there is at any time what was there before, or all of it.
///
/// The bytes go to a hidden file in the same folder, which takes the name of `path` when all are written and is removed
/// if that fails. Through a link its target is replaced. What is no regular file (a pipe, `/dev/null`) is written to
/// directly.
///
/// # Errors
/// Names `path` and what the system or `write` says.
pub fn write(path: impl AsRef<Path>, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let path = path.as_ref();
    let write_to = |file: File| {
        let mut file = BufWriter::with_capacity(1 << 16, file);
        write(&mut file)?;
        file.flush()
    };
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if fs::metadata(&target).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        return OpenOptions::new()
            .write(true)
            .open(&target)
            .and_then(write_to)
            .map_err(Error::io(path));
    }
    if target.file_name().is_none() || target.is_dir() {
        return Err(Error::dataset(path, "is a folder, not a file to write"));
    }
    let (temporary, file) = Temporary::create(&target).map_err(Error::io(path))?;
    write_to(file)
        .and_then(|()| temporary.rename(&target))
        .map_err(Error::io(path))
}

/// A file that is removed unless it gets its final name.
#[derive(Debug)]
pub(crate) struct Temporary(PathBuf);

impl Temporary {
    /// Makes one beside `target`, to write and to read.
    pub(crate) fn create(target: &Path) -> io::Result<(Self, File)> {
        let (path, file) = beside(target, |path| {
            OpenOptions::new().read(true).write(true).create_new(true).open(path)
        })?;
        Ok((Self(path), file))
    }

    fn rename(self, target: &Path) -> io::Result<()> {
        fs::rename(&self.0, target)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // Nothing to remove after the renaming.
        let _ = fs::remove_file(&self.0);
    }
}

/// Makes something hidden beside `target`, by a name that is free.
fn beside<T>(target: &Path, make: impl Fn(&Path) -> io::Result<T>) -> io::Result<(PathBuf, T)> {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    let mut attempt = 0;
    loop {
        let path = target.with_file_name(format!(".{name}.{}-{attempt}.tmp", std::process::id()));
        match make(&path) {
            Err(e) if e.kind() == ErrorKind::AlreadyExists && attempt < 1000 => attempt += 1,
            made => return made.map(|made| (path, made)),
        }
    }
}

/// Finds out before the work whether a [`Folder`] can be written: there is none by this name, or it is empty.
///
/// # Errors
/// Names the folder and what is in the way.
pub fn check_folder(path: &Path) -> Result<()> {
    if path.file_name().is_none() {
        return Err(Error::dataset(path, "is no name for a new folder"));
    }
    match fs::read_dir(path) {
        Ok(mut entries) => match entries.next() {
            None => Ok(()),
            Some(_) => Err(Error::dataset(path, "is not empty; name a new folder")),
        },
        Err(e) if e.kind() == ErrorKind::NotFound => {
            let above = path.parent().filter(|above| !above.as_os_str().is_empty());
            match above.unwrap_or(Path::new(".")) {
                above if above.is_dir() => Ok(()),
                above => Err(Error::dataset(path, format!("there is no folder {}", above.display()))),
            }
        }
        Err(e) => Err(Error::io(path)(e)),
    }
}

/// A folder in the making, hidden beside the one that it becomes; gone unless it is finished.
#[derive(Debug)]
pub struct Folder<'a> {
    path: PathBuf,
    target: &'a Path,
}

impl<'a> Folder<'a> {
    /// Begins one that becomes `target`.
    ///
    /// # Errors
    /// As [`check_folder`].
    pub fn begin(target: &'a Path) -> Result<Self> {
        check_folder(target)?;
        let (path, ()) = beside(target, |path| fs::create_dir(path)).map_err(Error::io(target))?;
        Ok(Self { path, target })
    }

    /// Where its files go.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its name.
    ///
    /// # Errors
    /// Names the folder and what the system says.
    pub fn finish(self) -> Result<()> {
        match fs::remove_dir(self.target) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(e),
            _ => fs::rename(&self.path, self.target),
        }
        .map_err(Error::io(self.target))
    }
}

impl Drop for Folder<'_> {
    fn drop(&mut self) {
        // Nothing to remove once it has its name.
        let _ = fs::remove_dir_all(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_old_file_stays_until_the_new_one_is_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("out.ply");
        write(&path, |w| w.write_all(b"old")).unwrap();
        let error = write(&path, |w| {
            w.write_all(b"half")?;
            assert_eq!(fs::read(&path)?, b"old");
            Err(io::Error::other("disk full"))
        });
        assert!(error.unwrap_err().to_string().ends_with("out.ply: disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["out.ply"]);
        write(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(dir.path()), ["out.ply"]);
    }

    #[test]
    fn a_panic_leaves_nothing_behind() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("out.ply");
        let caught = std::panic::catch_unwind(|| write(&path, |_| panic!("on purpose")));
        assert!(caught.is_err());
        assert_eq!(names(dir.path()), [""; 0]);
    }

    #[test]
    fn folders_missing_and_present_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let missing = write(dir.path().join("no/out.ply"), |_| Ok(()))
            .unwrap_err()
            .to_string();
        assert!(missing.contains("no/out.ply: No such file"), "{missing}");
        assert!(
            write(dir.path(), |_| Ok(()))
                .unwrap_err()
                .to_string()
                .ends_with("not a file to write")
        );
    }

    #[test]
    fn a_folder_appears_when_it_is_complete() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("tiles");
        let begun = Folder::begin(&target).unwrap();
        fs::write(begun.path().join("a"), "a").unwrap();
        assert!(!target.exists());
        drop(begun);
        assert_eq!(names(dir.path()), [""; 0]);
        fs::create_dir(&target).unwrap(); // empty: it is replaced
        let begun = Folder::begin(&target).unwrap();
        fs::write(begun.path().join("a"), "a").unwrap();
        begun.finish().unwrap();
        assert_eq!(
            (names(dir.path()), names(&target)),
            (vec!["tiles".into()], vec!["a".into()])
        );
        let full = Folder::begin(&target).unwrap_err().to_string();
        assert!(full.ends_with("tiles: is not empty; name a new folder"), "{full}");
        let missing = check_folder(&dir.path().join("no/tiles")).unwrap_err().to_string();
        assert!(missing.contains("no/tiles: there is no folder"), "{missing}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_kept_and_devices_written_to() {
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real"), dir.path().join("link"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write(&link, |w| w.write_all(b"new")).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
        write("/dev/null", |w| w.write_all(b"gone")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }
}
