//! The files that a run makes, checked before the work: none may be an input, or another output.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::{Result, RunError};
use crate::surface;

/// The files that a run makes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Outputs {
    /// The surface: `.ply`, `.glb`, `.obj`, `.html`, `NAME/tileset.json`, or `-` for standard output.
    pub mesh: Option<PathBuf>,
    /// Scans after which the mesh so far is written, again and again.
    pub mesh_every: Option<usize>,
    /// Whether the mesh gets the colours that the log's cameras saw.
    pub color: bool,
    /// Whether intensities are averaged: the mesh and the map get them.
    pub intensity: bool,
    /// The run as a recording of ROS 2's standard messages, `.mcap`.
    pub recording: Option<PathBuf>,
    /// The folder of labels that tell which returns move.
    pub labels: Option<PathBuf>,
    /// The map.
    pub map: Option<PathBuf>,
    /// The poses of the scans: TUM, or KITTI where scans have no times.
    pub poses: Option<PathBuf>,
    /// What is known of the sensor, the errors included that refinement found ([`tsdfuse_io::sensor_file`]).
    pub sensor: Option<PathBuf>,
    /// A picture of the whole map.
    pub preview: Option<PathBuf>,
    /// What was done, as JSON.
    pub report: Option<PathBuf>,
}

impl Outputs {
    fn files(&self) -> impl Iterator<Item = &Path> {
        let files = [
            &self.mesh,
            &self.map,
            &self.poses,
            &self.sensor,
            &self.preview,
            &self.report,
            &self.recording,
        ];
        files.into_iter().flatten().map(PathBuf::as_path)
    }

    /// The first result, beside which temporary files go.
    pub(crate) fn first(&self) -> Option<&Path> {
        let result = self.mesh.as_deref().or(self.map.as_deref())?;
        // The folder of tiles is not there yet.
        result.parent().filter(|_| surface::is_tileset(result)).or(Some(result))
    }

    /// Refuses what cannot be written, and what would overwrite one of `inputs` (files, or folders of logs) or another output.
    ///
    /// # Errors
    /// [`RunError::Config`] or [`RunError::Io`] names the file.
    pub fn check(&self, inputs: &[&Path], store: Option<&Path>) -> Result<()> {
        if let Some(mesh) = &self.mesh {
            if self.mesh_every.is_some() && mesh.as_os_str() == "-" {
                return Err(RunError::config(
                    "--mesh-every needs a file as --output, not standard output",
                ));
            }
            if self.mesh_every.is_some() && surface::is_tileset(mesh) {
                return Err(RunError::config(
                    "--mesh-every writes one file again and again, not tiles",
                ));
            }
            surface::check(mesh)?;
            if self.color || self.intensity {
                surface::check_painted(mesh)?;
            }
        } else if self.color {
            return Err(RunError::config("--color needs a mesh: --output"));
        }
        if (self.color || self.intensity) && self.mesh_every.is_some() {
            return Err(RunError::config(
                "--mesh-every with --color or --intensity: meshes on the way have neither",
            ));
        }
        if let Some(labels) = self
            .labels
            .as_deref()
            .filter(|labels| labels.exists() && !labels.is_dir())
        {
            return Err(RunError::config(format_args!(
                "{}: is a file, not a folder for labels",
                labels.display()
            )));
        }
        let is_mcap = |path: &PathBuf| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap"));
        if let Some(recording) = self.recording.as_ref().filter(|path| !is_mcap(path)) {
            return Err(RunError::config(format_args!(
                "{}: a run is recorded as .mcap",
                recording.display()
            )));
        }
        if let Some(preview) = &self.preview {
            tsdfuse_io::png::check(preview).map_err(RunError::config)?;
        }
        let outputs: Vec<&Path> = self.files().chain(store).collect();
        check(inputs, &outputs)
    }

    /// Refuses what needs the whole map in memory.
    ///
    /// # Errors
    /// [`RunError::Config`] says what.
    pub fn check_in_parts(&self) -> Result<()> {
        let wrong = |reason: String| RunError::config(format_args!("--memory and --store: {reason}"));
        if self.labels.is_some() {
            return Err(wrong(
                "--labels needs a run in one go, with the whole map in memory".to_owned(),
            ));
        }
        if self.preview.is_some() {
            return Err(wrong("--preview needs the whole map in memory".to_owned()));
        }
        let mesh = self.mesh.as_deref().map_or(Ok(()), surface::check_in_parts);
        mesh.map_err(|error| wrong(error.to_string()))
    }
}

/// The name of 3D Tiles; their folder is made.
const TILESET: &str = "tileset.json";

/// Refuses outputs that cannot be written, that are inputs, or that are one file.
///
/// # Errors
/// [`RunError::Config`] or [`RunError::Io`] names the file.
pub fn check(inputs: &[&Path], outputs: &[&Path]) -> Result<()> {
    let outputs: Vec<&Path> = outputs.iter().copied().filter(|path| path.as_os_str() != "-").collect();
    let resolved: Vec<PathBuf> = outputs.iter().map(|path| resolved(path)).collect();
    let inputs: Vec<PathBuf> = inputs.iter().filter_map(|path| path.canonicalize().ok()).collect();
    for (i, (path, place)) in outputs.iter().zip(&resolved).enumerate() {
        let shown = path.display();
        if resolved[..i].contains(place) {
            return Err(RunError::config(format_args!(
                "{shown}: two outputs cannot be the same file"
            )));
        }
        // Of a log's folder only what is there already could be an input.
        if let Some(input) = inputs
            .iter()
            .find(|input| place == *input || (place.exists() && place.starts_with(input)))
        {
            return Err(RunError::config(format_args!(
                "{shown}: would overwrite an input, {}; choose another name",
                input.display()
            )));
        }
        if path.file_name() != Some(OsStr::new(TILESET)) {
            check_file(path)?;
        }
    }
    Ok(())
}

/// A path without links, as far as it exists.
fn resolved(path: &Path) -> PathBuf {
    if let Ok(path) = path.canonicalize() {
        return path;
    }
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    match (folder.canonicalize(), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
    }
}

/// Checks that a file can be made.
///
/// # Errors
/// [`RunError::Io`] names the file and what is wrong.
pub fn check_file(path: &Path) -> Result<()> {
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let wrong = |reason: String| Err(tsdfuse_io::Error::dataset(path, reason).into());
    if !folder.is_dir() {
        return wrong(format!("no such folder: {}", folder.display()));
    }
    if path.is_dir() {
        return wrong("is a folder, not a file to write".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn no_output_is_an_input_or_another_output() {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("log");
        fs::create_dir(&log).unwrap();
        for name in ["000000.ply", "poses.txt"] {
            fs::write(log.join(name), "").unwrap();
        }
        fs::write(dir.path().join("run.toml"), "").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(log.join("poses.txt"), dir.path().join("link.txt")).unwrap();
        let config = dir.path().join("run.toml");
        let told = |outputs: &[PathBuf]| {
            let outputs: Vec<&Path> = outputs.iter().map(PathBuf::as_path).collect();
            check(&[&log, &config], &outputs).err().map(|e| e.to_string())
        };
        let at = |name: &str| dir.path().join(name);
        assert_eq!(
            told(&[at("mesh.ply"), at("map.tsdf"), at("log/mesh.ply"), "-".into()]),
            None
        );
        for bad in [
            "log/000000.ply",
            "log/poses.txt",
            "log/../log/poses.txt",
            "run.toml",
            "log",
        ] {
            assert!(told(&[at(bad)]).unwrap().contains("would overwrite"), "{bad}");
        }
        #[cfg(unix)]
        assert!(told(&[at("link.txt")]).unwrap().contains("would overwrite"));
        assert!(
            told(&[at("a.ply"), at("log/../a.ply")])
                .unwrap()
                .contains("cannot be the same file")
        );
        assert!(told(&[at("nowhere/a.ply")]).unwrap().contains("no such folder"));
        fs::create_dir(at("folder")).unwrap();
        assert!(told(&[at("folder")]).unwrap().contains("is a folder"));
    }
}
