//! Output files and folders that appear complete or not at all.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Writes a file through `write`. At any time, `path` is either what it was before or the complete new file.
///
/// The bytes go to a hidden file in the same folder, which is renamed to `path` when it is complete, and removed if anything
/// fails. Behind a link, the target is replaced. What is no regular file (a pipe, `/dev/null`) is written to directly.
///
/// # Errors
/// Names `path` and what the system or `write` says. A process that does not ignore or handle the signal SIGXFSZ is ended by the
/// system where a file becomes larger than `ulimit -f` allows; otherwise that is an error as well.
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
            .map_err(not_written(path));
    }
    if target.file_name().is_none() || target.is_dir() {
        return Err(Error::dataset(path, "is a folder, not a file to write"));
    }
    let (temporary, file) = Temporary::create(&target).map_err(Error::io(path))?;
    write_to(file)
        .and_then(|()| temporary.rename(&target))
        .map_err(not_written(path))
}

/// An error of writing; says of a file that is too large which limits there are.
fn not_written(path: &Path) -> impl FnOnce(io::Error) -> Error {
    move |error| {
        let error = match error.kind() {
            ErrorKind::FileTooLarge => io::Error::new(
                ErrorKind::FileTooLarge,
                "the file becomes larger than the file system or `ulimit -f` allows",
            ),
            _ => error,
        };
        Error::io(path)(error)
    }
}

/// A file that is written here and there, and appears under its name when it is complete; removed unless it is.
#[derive(Debug)]
pub(crate) struct AtomicFile {
    file: BufWriter<File>,
    temporary: Temporary,
    path: PathBuf,
}

impl AtomicFile {
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        if target.file_name().is_none() || target.is_dir() {
            return Err(Error::dataset(path, "is a folder, not a file to write"));
        }
        let (temporary, file) = Temporary::create(&target).map_err(Error::io(path))?;
        Ok(Self {
            file: BufWriter::with_capacity(1 << 20, file),
            temporary,
            path: target,
        })
    }

    /// Gives the file its name.
    pub(crate) fn commit(mut self) -> Result<()> {
        self.file.flush().map_err(not_written(&self.path))?;
        self.temporary.rename(&self.path).map_err(not_written(&self.path))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl io::Seek for AtomicFile {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// A file that is removed unless it is renamed.
#[derive(Debug)]
pub(crate) struct Temporary(PathBuf);

impl Temporary {
    /// Creates one beside `target`, for writing and reading.
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
        // After renaming, there is nothing to remove.
        let _ = fs::remove_file(&self.0);
    }
}

/// Makes something hidden beside `target`, with a name that is free.
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

/// Checks that a [`Folder`] can be written, so that this is known before the work is done: there is no folder of this name, or it
/// is empty.
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

/// A folder that is being written, hidden beside its final place; removed unless it is finished.
#[derive(Debug)]
pub struct Folder<'a> {
    path: PathBuf,
    target: &'a Path,
}

impl<'a> Folder<'a> {
    /// Begins a folder that becomes `target`.
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

    /// Gives the folder its final name.
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
        // Once it has its final name, there is nothing to remove.
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

    /// Set for the child below.
    const CHILD: &str = "TSDFUSE_TEST_FILE_LIMIT";

    #[test]
    #[cfg(target_os = "linux")]
    fn a_limit_on_the_size_of_files_is_an_error_and_leaves_nothing() {
        if let Ok(folder) = std::env::var(CHILD) {
            let path = Path::new(&folder).join("out.ply");
            let error = write(&path, |w| w.write_all(&vec![1; 1 << 20])).unwrap_err();
            println!("{error}");
            assert_eq!(names(Path::new(&folder)), [""; 0]);
            return;
        }
        let dir = tempfile::tempdir().unwrap();
        let output = std::process::Command::new("sh")
            .args(["-c", "trap '' XFSZ; ulimit -f 64; exec \"$@\"", "sh"])
            .arg(std::env::current_exe().unwrap())
            .args(["atomic::tests::a_limit_on_the_size", "--nocapture"])
            .env(CHILD, dir.path())
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stdout);
        let expected = "out.ply: the file becomes larger than the file system or `ulimit -f` allows";
        assert!(output.status.success() && told.contains(expected), "{told}");
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
