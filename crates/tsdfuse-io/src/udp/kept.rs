//! What a sensor sends, kept as a capture in a temporary folder.

use std::fs::{self, File};
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempDir;

use crate::capture::writer;
use crate::error::{Error, Result};
use crate::source::Kept;

/// How the names of such folders begin.
const PREFIX: &str = ".tsdfuse-packets-";
/// In such a folder: the capture, and what is locked as long as somebody needs it.
const CAPTURE: &str = "packets.pcap";
const LOCK: &str = "lock";

/// Keeps datagrams, once that is asked for.
pub(super) struct Packets {
    /// Of the stream.
    name: String,
    state: Mutex<State>,
}

enum State {
    /// Nobody asked for it.
    Unwanted,
    Growing(File, Folder),
    /// Nothing is added any more.
    Complete(Folder),
    /// It could not be written.
    Failed(io::ErrorKind, String),
}

/// A folder that is removed in the end.
struct Folder {
    folder: TempDir,
    _lock: File,
}

impl Folder {
    fn create(parent: &Path) -> io::Result<Self> {
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
        let lock = File::create(folder.path().join(LOCK))?;
        lock.lock()?;
        Ok(Self { folder, _lock: lock })
    }

    fn capture(&self) -> PathBuf {
        self.folder.path().join(CAPTURE)
    }
}

impl Packets {
    pub(super) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            state: Mutex::new(State::Unwanted),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a datagram that the sensor sent from one address to the other.
    pub(super) fn take(&self, received_ns: i64, ends: [SocketAddr; 2], payload: &[u8]) {
        let mut state = self.lock();
        if let State::Growing(file, folder) = &mut *state
            && let Err(error) = writer::append(file, received_ns, ends, payload)
        {
            let reason = format!("{}: {error}", folder.capture().display());
            *state = State::Failed(error.kind(), reason);
        }
    }
}

impl Kept for Packets {
    fn keep(&self, folder: &Path) -> Result<()> {
        remove_stale(folder);
        let begin = || {
            let folder = Folder::create(folder)?;
            let mut file = File::create_new(folder.capture())?;
            writer::begin(&mut file)?;
            Ok(State::Growing(file, folder))
        };
        *self.lock() = begin().map_err(Error::io(folder))?;
        Ok(())
    }

    fn recording(&self) -> Result<PathBuf> {
        let mut state = self.lock();
        *state = match std::mem::replace(&mut *state, State::Unwanted) {
            State::Growing(_, folder) => State::Complete(folder),
            other => other,
        };
        match &*state {
            State::Complete(folder) => Ok(folder.capture()),
            State::Failed(kind, reason) => Err(Error::io(&self.name)(io::Error::new(
                *kind,
                format!("what it sent could not be kept: {reason}"),
            ))),
            State::Unwanted | State::Growing(..) => Err(Error::dataset(&self.name, "what it sent was not kept")),
        }
    }

    fn forget(&self) {
        *self.lock() = State::Unwanted;
    }
}

/// Removes what processes that were killed left in a folder: nobody has locked it.
fn remove_stale(parent: &Path) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let is_ours = entry.file_name().to_string_lossy().starts_with(PREFIX);
        let lock = is_ours
            .then(|| File::open(entry.path().join(LOCK)))
            .and_then(io::Result::ok);
        if lock.is_some_and(|lock| lock.try_lock().is_ok()) {
            // If the system refuses, it stays.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packets() -> Packets {
        Packets::new("udp://:2368")
    }

    fn left(parent: &Path) -> usize {
        fs::read_dir(parent).unwrap().count()
    }

    #[test]
    fn what_killed_processes_left_is_removed_and_what_others_need_is_not() {
        let parent = tempfile::tempdir().unwrap();
        let (used, next) = (packets(), packets());
        used.keep(parent.path()).unwrap();
        let stale = parent.path().join(format!("{PREFIX}killed"));
        fs::create_dir(&stale).unwrap();
        File::create(stale.join(LOCK)).unwrap();
        next.keep(parent.path()).unwrap();
        assert!(!stale.exists() && used.recording().unwrap().is_file());
        assert_eq!(left(parent.path()), 2);
        used.forget();
        assert_eq!(left(parent.path()), 1);
        next.forget();
        assert_eq!(left(parent.path()), 0);
    }

    #[test]
    fn a_full_disk_is_told_in_a_sentence_and_given_back() {
        let parent = tempfile::tempdir().unwrap();
        let packets = packets();
        assert!(packets.recording().unwrap_err().to_string().ends_with("was not kept"));
        packets.keep(parent.path()).unwrap();
        // A file that cannot be written, as on a full disk.
        if let State::Growing(file, folder) = &mut *packets.lock() {
            *file = File::open(folder.capture()).unwrap();
        }
        let ends = ["127.0.0.1:2000", "127.0.0.1:2368"].map(|end| end.parse().unwrap());
        packets.take(0, ends, &[1; 1206]);
        assert_eq!(left(parent.path()), 0);
        let told = packets.recording().unwrap_err().to_string();
        assert!(
            told.starts_with("udp://:2368: what it sent could not be kept: "),
            "{told}"
        );
        assert!(packets.keep(&parent.path().join("none")).is_err());
    }
}
