//! What meshes are compared with.

use std::path::PathBuf;

use anyhow::{Context, Result};
use glam::DVec3;
use serde::Serialize;
use tsdfuse::scan::RangeLimits;
use tsdfuse_eval::{Protocol, Reference};
use tsdfuse_io::{Dataset, OpenOptions};

use super::args::Args;
use crate::eval::{read_points, read_reference};
use crate::progress::{self, note};

/// The reference, and what it is.
#[derive(Debug, Serialize)]
pub(crate) struct Chosen {
    #[serde(skip)]
    pub(crate) reference: Reference,
    /// In words.
    pub(crate) words: String,
    /// The file, the folder of the truth, or the data set.
    pub(crate) path: PathBuf,
    pub(crate) kind: &'static str,
    /// Points that meshes should come close to.
    pub(crate) points: Option<usize>,
    /// Triangles of a mesh.
    pub(crate) triangles: Option<usize>,
    /// How meshes are compared with it.
    pub(crate) protocol: Protocol,
}

impl Chosen {
    /// What was asked for, or the truth of a simulated data set, or the points of the scans `indices`.
    pub(crate) fn by(args: &Args, dataset: &Dataset, indices: &[usize], range: RangeLimits) -> Result<Self> {
        let own = &args.settings.dataset;
        let truth = ["scene.ply", "hits.ply"].map(|name| own.join(name));
        let (reference, words, path) = match &args.reference {
            Some(path) => {
                let reference = read_reference(path, args.every as usize, &OpenOptions::default())?;
                let words = match path.is_dir() {
                    true => format!("the points of the scans of {}", path.display()),
                    false => format!("the {} {}", reference.kind(), path.display()),
                };
                (reference, words, path)
            }
            None if truth.iter().all(|file| file.is_file()) => {
                let reference = simulated(&truth).with_context(|| own.display().to_string())?;
                let words = "the true surface of the simulation (scene.ply); completeness: of the part that beams hit (hits.ply)";
                (reference, words.to_owned(), own)
            }
            None => {
                if truth[0].is_file() {
                    note(
                        "there is a scene.ply but no hits.ply: simulate again for the truth; points of the scans are the reference",
                    );
                }
                let points = points(dataset, indices, args.every, range)?;
                (
                    Reference::cloud(points)?,
                    scans_in_words(indices.len(), args.every),
                    own,
                )
            }
        };
        let default = if reference.kind() == "mesh" {
            "surface"
        } else {
            "thesis"
        };
        let name = args.protocol.as_deref().unwrap_or(default);
        let mut protocol = Protocol::by_name(name).with_context(|| format!("no protocol {name}"))?;
        protocol.samples = args.samples.unwrap_or(protocol.samples);
        Ok(Self {
            words,
            path: path.clone(),
            kind: reference.kind(),
            points: reference.points().map(<[_]>::len),
            triangles: reference.as_mesh().map(|mesh| mesh.triangles.len()),
            reference,
            protocol,
        })
    }
}

/// The truth of a simulated data set.
fn simulated([scene, hits]: &[PathBuf; 2]) -> Result<Reference> {
    let scene = read_reference(scene, 1, &OpenOptions::default())?;
    Ok(scene.with_observed(read_points(hits)?)?)
}

fn scans_in_words(scans: usize, every: u32) -> String {
    match every {
        1 => format!("the points of all {scans} scans"),
        _ => format!("the points of one of {every} of {scans} scans"),
    }
}

/// The valid points of every `every`-th scan, in the world.
fn points(dataset: &Dataset, indices: &[usize], every: u32, range: RangeLimits) -> Result<Vec<DVec3>> {
    let chosen: Vec<usize> = indices.iter().copied().step_by(every as usize).collect();
    let bar = progress::scans("reading the reference", chosen.len());
    let mut all = Vec::new();
    for read in dataset.iter_indices(chosen) {
        bar.inc(1);
        // A scan that cannot be read is told of where it is to be fused.
        let Ok(mut scan) = read.scan else { continue };
        scan.drop_invalid(&range);
        all.extend(scan.points_in_world());
    }
    Ok(all)
}
