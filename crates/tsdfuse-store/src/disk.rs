//! Bytes of a file, at their places.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::time::Duration;

use crate::format::Extent;

/// A file that is locked as long as it is open: a writer excludes everybody else, readers exclude writers.
#[derive(Debug)]
pub(crate) struct Disk {
    file: File,
    /// What was done to it.
    #[cfg(test)]
    pub(crate) steps: std::cell::RefCell<Vec<Step>>,
}

/// Something that was done to a file.
#[cfg(test)]
#[derive(Clone, Debug)]
pub(crate) enum Step {
    Write(u64, Vec<u8>),
    Sync,
}

/// How often, and how many milliseconds apart, it is tried whether a process that was killed has let go of its file.
const TRIES: u32 = 40;
const BETWEEN_MS: u64 = 50;

impl Disk {
    /// An empty file.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        Self::lock(options.create(true).truncate(true), path, true, TRIES)
    }

    /// A file that is there.
    pub(crate) fn open(path: &Path, is_written: bool) -> io::Result<Self> {
        Self::lock(&mut OpenOptions::new(), path, is_written, TRIES)
    }

    /// A file that nobody has open.
    pub(crate) fn open_unused(path: &Path) -> io::Result<Self> {
        Self::lock(&mut OpenOptions::new(), path, true, 1)
    }

    fn lock(options: &mut OpenOptions, path: &Path, is_written: bool, tries: u32) -> io::Result<Self> {
        let file = options.read(true).write(is_written).open(path)?;
        let lock = || {
            if is_written {
                file.try_lock()
            } else {
                file.try_lock_shared()
            }
        };
        let mut locked = lock();
        for _ in 1..tries {
            if !matches!(locked, Err(TryLockError::WouldBlock)) {
                break;
            }
            std::thread::sleep(Duration::from_millis(BETWEEN_MS));
            locked = lock();
        }
        match locked {
            Ok(()) => Ok(Self {
                file,
                #[cfg(test)]
                steps: Default::default(),
            }),
            Err(TryLockError::Error(error)) => Err(error),
            Err(TryLockError::WouldBlock) => Err(io::Error::other("another process has it open")),
        }
    }

    pub(crate) fn length(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Fills `bytes` with what is at an offset.
    pub(crate) fn read_exact(&self, offset: u64, bytes: &mut [u8]) -> io::Result<()> {
        let mut file = &self.file;
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(bytes)
    }

    /// Reads a part of the file. What a damaged file says of a length is not believed.
    ///
    /// # Errors
    /// What is wrong.
    pub(crate) fn read(&self, extent: Extent) -> Result<Vec<u8>, String> {
        let system = |e: io::Error| e.to_string();
        let end = self.length().map_err(system)?;
        if extent.offset.checked_add(extent.length).is_none_or(|last| last > end) {
            return Err("the file ends before it".to_owned());
        }
        let mut bytes = Vec::new();
        let length = extent.length as usize;
        bytes.try_reserve_exact(length).map_err(|e| e.to_string())?;
        bytes.resize(length, 0);
        self.read_exact(extent.offset, &mut bytes).map_err(system)?;
        Ok(bytes)
    }

    pub(crate) fn write(&self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        #[cfg(test)]
        self.steps.borrow_mut().push(Step::Write(offset, bytes.to_vec()));
        let mut file = &self.file;
        file.seek(SeekFrom::Start(offset))?;
        file.write_all(bytes)
    }

    /// Waits until everything that was written is on the disk.
    pub(crate) fn sync(&self) -> io::Result<()> {
        #[cfg(test)]
        self.steps.borrow_mut().push(Step::Sync);
        self.file.sync_data()
    }
}

/// Makes sure that a new name outlives a power failure, where the system can do that.
pub(crate) fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    // Some systems cannot open folders, some file systems cannot sync them.
    let _ = File::open(folder.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all());
}
