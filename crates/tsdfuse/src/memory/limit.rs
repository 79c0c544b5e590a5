//! How much memory the blocks of a map may take, and the error if that does not suffice.

use std::{fmt, fs, sync::OnceLock};

/// The blocks of a map need more memory than they may take, or than there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OutOfMemory {
    /// The map reached the limit of [`VoxelMap::set_memory_limit`](crate::VoxelMap::set_memory_limit).
    #[error("the map needs more than {}, its memory limit", Bytes(*limit_bytes))]
    Limit {
        /// The limit.
        limit_bytes: usize,
    },
    /// The operating system refused.
    #[error("the map has {} and needs more memory than the system gives", Bytes(*map_bytes))]
    System {
        /// What the blocks of the map take.
        map_bytes: usize,
    },
}

struct Bytes(usize);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0..0x4000_0000 => write!(f, "{:.1} MiB", self.0 as f64 / f64::from(1 << 20)),
            _ => write!(f, "{:.1} GiB", self.0 as f64 / f64::from(1 << 30)),
        }
    }
}

/// The limit of a new map: three quarters of the memory that this process can have, so that there is room for scans and
/// meshes. `usize::MAX`, no limit, on systems where it is not known how much that is.
pub(super) fn default_limit() -> usize {
    static LIMIT: OnceLock<usize> = OnceLock::new();
    *LIMIT.get_or_init(|| {
        let bytes = SOURCES
            .iter()
            .filter_map(|(path, bytes)| bytes(&fs::read_to_string(path).ok()?));
        bytes.min().map_or(usize::MAX, |bytes| bytes / 4 * 3)
    })
}

/// A file, and what its text says of a limit in bytes.
type Told = (&'static str, fn(&str) -> Option<usize>);

/// The files in which Linux tells how much memory a process can have: of the machine, of the control group (container), old and
/// new, and of the process (`ulimit -v`).
const SOURCES: [Told; 4] = [
    ("/proc/meminfo", |text| {
        let kib = text.strip_prefix("MemTotal:")?.split_ascii_whitespace().next()?;
        kib.parse::<usize>().ok()?.checked_mul(1024)
    }),
    ("/sys/fs/cgroup/memory.max", number),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", number),
    ("/proc/self/limits", |text| {
        let soft = text.lines().find_map(|line| line.strip_prefix("Max address space"))?;
        number(soft.split_ascii_whitespace().next()?)
    }),
];

/// `None` for `max` and `unlimited`.
fn number(text: &str) -> Option<usize> {
    text.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_system_tells_is_understood() {
        let [(_, machine), (_, group), _, (_, process)] = SOURCES;
        assert_eq!(
            machine("MemTotal:       24660000 kB\nMemFree: 1 kB\n"),
            Some(24_660_000 * 1024)
        );
        assert_eq!((machine(""), machine("MemTotal: x")), (None, None));
        assert_eq!((group("max\n"), group("1073741824\n")), (None, Some(1 << 30)));
        let limits = |soft| {
            format!(
                "Limit Soft Limit Hard Limit Units\nMax processes 1 1 x\nMax address space   {soft}  unlimited bytes\n"
            )
        };
        assert_eq!(process(&limits("4194304000")), Some(4_194_304_000));
        assert_eq!(process(&limits("unlimited")), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn there_is_a_limit() {
        assert!((1 << 26..usize::MAX).contains(&default_limit()), "{}", default_limit());
    }

    #[test]
    fn errors_tell_how_much() {
        let told = OutOfMemory::Limit { limit_bytes: 3 << 30 }.to_string();
        assert_eq!(told, "the map needs more than 3.0 GiB, its memory limit");
        let told = OutOfMemory::System { map_bytes: 3 << 19 }.to_string();
        assert_eq!(told, "the map has 1.5 MiB and needs more memory than the system gives");
    }
}
