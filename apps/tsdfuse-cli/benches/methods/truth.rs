//! Simulated sequences: the files that are fused, and the truth that they came from.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use tsdfuse::glam::DVec3;
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};

use crate::measure::cell;
use crate::pictures::View;
use crate::run_tsdfuse;

/// What `tsdfuse simulate` is asked for; all else is its default.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sequence {
    pub(crate) scene: &'static str,
    pub(crate) sensor: &'static str,
    pub(crate) path: &'static str,
    pub(crate) scans: usize,
    /// For pictures.
    pub(crate) views: [View; 2],
}

pub(crate) const SEQUENCES: [Sequence; 2] = [
    Sequence {
        scene: "street",
        sensor: "pandar64",
        path: "vehicle",
        scans: 80,
        // Stairs, poles, a bench; road that the sensor saw from afar.
        views: [
            View {
                from: DVec3::new(-8.5, 1.0, 2.6),
                to: DVec3::new(-1.5, 9.0, 1.2),
            },
            View {
                from: DVec3::new(37.0, 0.0, 2.6),
                to: DVec3::new(52.0, 0.5, 0.0),
            },
        ],
    },
    Sequence {
        scene: "hall",
        sensor: "os0-128",
        path: "drone",
        scans: 70,
        // Shelves; stairs.
        views: [
            View {
                from: DVec3::new(3.5, -1.0, 2.6),
                to: DVec3::new(-2.0, -6.5, 1.6),
            },
            View {
                from: DVec3::new(-5.2, 2.6, 2.5),
                to: DVec3::new(-8.2, 7.0, 1.6),
            },
        ],
    },
];

impl Sequence {
    /// The simulator that makes the sequence, with other noise.
    pub(crate) fn simulator(&self, noise: NoiseModel) -> Result<Simulator> {
        let scene = scene::by_name(self.scene, 0).context("no such scene")?;
        let sensor = tsdfuse::sensor::model(self.sensor).context("no such sensor")?;
        let poses = path::by_name(self.path, &scene, self.scans).context("no such path")?;
        let config = SimulatorConfig {
            noise,
            ..Default::default()
        };
        Ok(Simulator::new(scene, sensor, poses, config)?)
    }

    /// The folder of the sequence; it is written if it is not there, or if the simulator gives other scans by now.
    pub(crate) fn written(&self, below: &Path) -> Result<PathBuf> {
        let folder = below.join(format!("{}-{}-{}", self.scene, self.sensor, self.scans));
        if !self.is_in(&folder).unwrap_or(false) {
            if folder.exists() {
                fs::remove_dir_all(&folder)?;
            }
            let scans = self.scans.to_string();
            let arguments = [
                "simulate",
                "--scene",
                self.scene,
                "--sensor",
                self.sensor,
                "--scans",
                &scans,
            ];
            run_tsdfuse(&[&arguments[..], &["--path", self.path, "-o", &folder.to_string_lossy()]].concat())?;
            ensure!(
                self.is_in(&folder)?,
                "{}: not what was simulated here",
                folder.display()
            );
        }
        Ok(folder)
    }

    /// Whether the last scan in a folder is that of the sequence.
    fn is_in(&self, folder: &Path) -> Result<bool> {
        let last = self.scans - 1;
        let written = tsdfuse_io::open(folder)?.read(last)?;
        let simulated = self.simulator(NoiseModel::default())?.nth_scan(last);
        Ok(simulated.is_some_and(|scan| scan.points == written.points))
    }

    /// The true surface that was hit: the returns of the sequence without the noise of their ranges, in the world, the first
    /// one in each cell of a grid with this edge.
    pub(crate) fn hits(&self, edge_m: f64) -> Result<Vec<DVec3>> {
        let simulator = self.simulator(NoiseModel {
            range_sigma_m: 0.0,
            ..Default::default()
        })?;
        let mut seen = HashSet::new();
        let mut hits = Vec::new();
        for scan in simulator.scans() {
            let points = scan.points.iter().map(|p| scan.pose.transform_point(p.as_dvec3()));
            hits.extend(points.filter(|&p| seen.insert(cell(p, edge_m))));
        }
        Ok(hits)
    }
}
