//! Where the files of an evaluation go.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::error::{Error, Result};

/// The folder of the results, if there is to be one, and a temporary one for the meshes and maps meanwhile.
pub(crate) struct Folder {
    output: Option<PathBuf>,
    /// Whether the output folder was not there before.
    is_new: bool,
    /// Taken when this is dropped.
    work: Option<TempDir>,
}

impl Folder {
    /// Refuses an output folder within a log, and files in it that would overwrite what is read.
    pub(crate) fn check(output: &Path, files: &[String], inputs: &[&Path]) -> Result<()> {
        let place = resolved(output);
        let folders = inputs.iter().filter(|input| input.is_dir());
        let mut folders = folders.filter_map(|input| Some((input, input.canonicalize().ok()?)));
        if let Some((input, _)) = folders.find(|(_, folder)| place.starts_with(folder)) {
            return Err(Error::config(format_args!(
                "{}: results do not go into the log that is read from {}",
                output.display(),
                input.display()
            )));
        }
        if output.is_dir() {
            let files: Vec<PathBuf> = files.iter().map(|name| output.join(name)).collect();
            let files: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
            tsdfuse_run::check_outputs(inputs, &files)?;
        }
        Ok(())
    }

    /// Creates both.
    pub(crate) fn create(output: Option<&Path>) -> Result<Self> {
        let mut folder = Self {
            output: output.map(Path::to_owned),
            is_new: output.is_some_and(|output| !output.exists()),
            work: None,
        };
        folder.work = Some(match output {
            None => tempfile::tempdir().map_err(Error::at(&std::env::temp_dir()))?,
            Some(output) => {
                fs::create_dir_all(output).map_err(Error::at(output))?;
                let work = tempfile::Builder::new().prefix(".work-").tempdir_in(output);
                work.map_err(Error::at(output))?
            }
        });
        Ok(folder)
    }

    /// A temporary file.
    pub(crate) fn temporary(&self, name: &str) -> PathBuf {
        let work = self.work.as_ref().map_or(Path::new("."), TempDir::path);
        work.join(name)
    }

    /// Where results go.
    pub(crate) fn output(&self) -> Option<&Path> {
        self.output.as_deref()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(self.work.take());
        if let (true, Some(output)) = (self.is_new, &self.output) {
            // A folder with results stays: only empty ones can be removed like this.
            let _ = fs::remove_dir(output);
        }
    }
}

/// A path without links, as far as it exists.
fn resolved(path: &Path) -> PathBuf {
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let there = full.ancestors().find_map(|a| Some((a, a.canonicalize().ok()?)));
    match there {
        Some((ancestor, real)) => full.strip_prefix(ancestor).map_or(full.clone(), |rest| real.join(rest)),
        None => full,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_do_not_go_into_a_log_nor_over_what_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir_all(at("log/scans")).unwrap();
        fs::create_dir(at("out")).unwrap();
        fs::write(at("out/a.ply"), "").unwrap();
        let (log, reference) = (at("log"), at("out/a.ply"));
        let check = |output: &str, file: &str| {
            Folder::check(&at(output), &[file.to_owned()], &[&log, &reference]).map_err(|e| e.to_string())
        };
        for good in ["out", "new", "new/deep", "log-2", "log/../new"] {
            assert_eq!(check(good, "b.ply"), Ok(()), "{good}");
        }
        for bad in ["log", "log/scans", "log/new", "log/new/deep", "out/../log/new"] {
            assert!(
                check(bad, "b.ply").unwrap_err().contains("results do not go into"),
                "{bad}"
            );
        }
        assert!(check("out", "a.ply").unwrap_err().contains("would overwrite"));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("log"), at("link")).unwrap();
            assert!(check("link/new", "b.ply").is_err());
        }
    }

    #[test]
    fn only_results_are_left_behind() {
        let dir = tempfile::tempdir().unwrap();
        let output = dir.path().join("out");
        for leaves in [false, true] {
            let folder = Folder::create(Some(&output)).unwrap();
            fs::write(folder.temporary("mesh.ply"), "").unwrap();
            if leaves {
                fs::write(output.join("table.md"), "").unwrap();
            }
            drop(folder);
            let left = fs::read_dir(&output).map_or(0, Iterator::count);
            assert_eq!((output.exists(), left), (leaves, usize::from(leaves)));
        }
        // What was there before stays.
        fs::remove_file(output.join("table.md")).unwrap();
        drop(Folder::create(Some(&output)).unwrap());
        assert!(output.exists());
    }
}
