//! Whether an optional file is there. What is there but cannot be looked at is an error, not silence.

use std::io::ErrorKind;
use std::path::Path;

use crate::error::{Error, Result};

/// Whether there is a file of that name.
///
/// # Errors
/// Names what cannot be looked at (a folder without permission, a link that leads nowhere), and what is no file.
pub(crate) fn file(path: &Path) -> Result<bool> {
    let there = metadata(path)?;
    match there {
        Some(there) if !there.is_file() => Err(Error::dataset(path, "is no file")),
        there => Ok(there.is_some()),
    }
}

/// Whether there is a folder of that name.
///
/// # Errors
/// Names what cannot be looked at, and what is no folder.
pub(crate) fn folder(path: &Path) -> Result<bool> {
    let there = metadata(path)?;
    match there {
        Some(there) if !there.is_dir() => Err(Error::dataset(path, "is no folder")),
        Some(_) => {
            // Whether it may be listed.
            std::fs::read_dir(path).map_err(Error::io(path))?;
            Ok(true)
        }
        None => Ok(false),
    }
}

fn metadata(path: &Path) -> Result<Option<std::fs::Metadata>> {
    match std::fs::metadata(path) {
        Ok(there) => Ok(Some(there)),
        // A link that leads nowhere is there.
        Err(e) if e.kind() == ErrorKind::NotFound && std::fs::symlink_metadata(path).is_err() => Ok(None),
        Err(e) if e.kind() == ErrorKind::NotADirectory => Ok(None),
        Err(e) => Err(Error::io(path)(e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_there_but_cannot_be_read_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir(at("folder")).unwrap();
        std::fs::write(at("file"), "").unwrap();
        assert!(file(&at("file")).unwrap() && folder(&at("folder")).unwrap());
        assert!(!file(&at("none")).unwrap() && !folder(&at("none")).unwrap() && !file(&at("file/none")).unwrap());
        for wrong in [file(&at("folder")), folder(&at("file"))] {
            let message = wrong.unwrap_err().to_string();
            assert!(
                message.ends_with(": is no file") || message.ends_with(": is no folder"),
                "{message}"
            );
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("nowhere", at("link")).unwrap();
            std::os::unix::fs::symlink("circle", at("circle")).unwrap();
            for name in ["link", "circle", "circle/0.u16"] {
                let message = file(&at(name)).unwrap_err().to_string();
                assert!(message.contains(name), "{message}");
            }
        }
    }
}
