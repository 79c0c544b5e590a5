//! What all meshes of an evaluation are compared with, and how.

use std::path::{Path, PathBuf};

use serde::Serialize;
use tsdfuse::scan::RangeLimits;
use tsdfuse_eval::{Protocol, Reference};
use tsdfuse_io::{Log, OpenOptions};

use crate::error::{Error, Result};
use crate::progress::{Progress, Watch};
use crate::reference;

/// The rules of measurement, as far as that is asked for.
#[derive(Clone, Debug)]
pub struct Comparing {
    /// A mesh, a cloud, or a log for the points of its scans. `None`: the true surface of a simulated log, otherwise the points
    /// of the log's own scans.
    pub reference: Option<PathBuf>,
    /// Where points of scans are the reference: only each so many-th scan.
    pub every: usize,
    /// A name of [`Protocol::NAMES`]. `None`: `surface` with a mesh as the reference, `thesis` with points.
    pub protocol: Option<String>,
    /// Samples on each mesh. `None`: as many as the protocol takes.
    pub samples: Option<usize>,
}

impl Default for Comparing {
    fn default() -> Self {
        Self {
            reference: None,
            every: 1,
            protocol: None,
            samples: None,
        }
    }
}

/// The reference, and how meshes are compared with it.
#[derive(Debug, Serialize)]
pub struct Truth {
    /// The reference itself.
    #[serde(skip)]
    pub reference: Reference,
    /// The same in words.
    pub words: String,
    /// Its file, or the log that it was made of.
    pub path: PathBuf,
    /// `mesh` or `cloud`.
    pub kind: &'static str,
    /// Points that meshes should come close to.
    pub points: Option<usize>,
    /// Triangles, if it is a mesh.
    pub triangles: Option<usize>,
    /// The rules of measurement with it.
    pub protocol: Protocol,
}

impl Comparing {
    /// Finds out before the work what cannot be.
    pub(crate) fn check(&self) -> Result<()> {
        self.protocol(self.protocol.as_deref().unwrap_or("surface")).map(drop)
    }

    fn protocol(&self, name: &str) -> Result<Protocol> {
        let protocol = Protocol::by_name(name);
        let mut protocol = protocol.ok_or_else(|| Error::config(format_args!("no protocol {name}")))?;
        protocol.samples = self.samples.unwrap_or(protocol.samples);
        protocol.check().map_err(Error::config)?;
        Ok(protocol)
    }

    /// Reads what was asked for, or the truth of a simulated log, or the points of these scans.
    pub(crate) fn read(
        &self,
        path: &Path,
        log: &Log,
        indices: &[usize],
        range: &RangeLimits,
        watch: &mut Watch<'_>,
    ) -> Result<Truth> {
        let [scene, hits] = ["scene.ply", "hits.ply"].map(|name| path.join(name));
        let defaults = OpenOptions::default();
        let (reference, words, path) = match &self.reference {
            Some(path) => {
                let reference = reference::read(path, self.every, &defaults, watch)?;
                let words = if path.is_dir() {
                    format!("the points of the scans of {}", path.display())
                } else {
                    format!("the {} {}", reference.kind(), path.display())
                };
                (reference, words, path.as_path())
            }
            None if scene.is_file() && hits.is_file() => {
                let reference = reference::read(&scene, 1, &defaults, watch)?;
                let words = "the true surface of the simulation (scene.ply); completeness: of the part that beams hit (hits.ply)";
                (reference::observed_at(reference, &hits)?, words.to_owned(), path)
            }
            None => {
                if scene.is_file() {
                    watch(Progress::Note(
                        "there is a scene.ply but no hits.ply: simulate again for the truth; points of the scans are the reference",
                    ));
                }
                let some = indices.iter().copied().step_by(self.every.max(1)).collect();
                // A scan that cannot be used is told of where it is to be fused.
                let points = reference::points_of(log, some, range, true, watch)?;
                (Reference::cloud(points)?, self.scans_in_words(indices.len()), path)
            }
        };
        let default = if reference.kind() == "mesh" {
            "surface"
        } else {
            "thesis"
        };
        Ok(Truth {
            words,
            path: path.to_owned(),
            kind: reference.kind(),
            points: reference.points().map(<[_]>::len),
            triangles: reference.as_mesh().map(|mesh| mesh.triangles.len()),
            reference,
            protocol: self.protocol(self.protocol.as_deref().unwrap_or(default))?,
        })
    }

    fn scans_in_words(&self, scans: usize) -> String {
        match self.every {
            0 | 1 => format!("the points of all {scans} scans"),
            every => format!("the points of one of {every} of {scans} scans"),
        }
    }
}
