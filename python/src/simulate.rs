//! Simulated scans of scenes that are known exactly.

use numpy::{PyArray1, PyArray3};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};

use crate::arrays::{Rows, pose_arrays, poses, triple};
use crate::error::{OrRaise, wrong};
use crate::mesh::Mesh;
use crate::scan::{Origin, Scan};
use crate::sensor;

/// Largest distance between the true surface and its mesh, metres.
const CHORD_M: f64 = 0.002;

/// A sensor that moves through a scene.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Simulation {
    simulator: Simulator,
    origin: std::sync::Arc<Origin>,
    scene: String,
}

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(signature = (scene, sensor=None, *, scans=80, path=None, noise=None, dropout=None, grazing_loss=true, motion=false, seed=0, offset=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        scene: &str,
        sensor: Option<&Bound<'_, PyAny>>,
        scans: usize,
        path: Option<&Bound<'_, PyAny>>,
        noise: Option<f64>,
        dropout: Option<f64>,
        grazing_loss: bool,
        motion: bool,
        seed: u64,
        offset: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let known = || scene::names().join(", ");
        let built = scene::by_name(scene, seed);
        let mut built = built.ok_or_else(|| wrong(format_args!("no scene {scene}; there are {}", known())))?;
        if let Some(offset) = offset {
            built = built.translated(triple("offset", offset)?);
        }
        let model = match sensor {
            Some(sensor) => sensor::model(sensor)?,
            None => tsdfuse::sensor::model("pandar64").ok_or_else(|| wrong("no sensor pandar64"))?,
        };
        let poses = match path {
            None => path::default_for(&built, scans),
            Some(path) => match path.extract::<String>() {
                Ok(name) => {
                    let known = || path::names().join(", ");
                    let found = path::by_name(&name, &built, scans);
                    found.ok_or_else(|| wrong(format_args!("no path {name}; there are {}", known())))?
                }
                Err(_) => poses("path", path)?,
            },
        };
        let usual = NoiseModel::default();
        let noise = NoiseModel {
            range_sigma_m: noise.unwrap_or(usual.range_sigma_m),
            dropout: dropout.unwrap_or(usual.dropout),
            weak_echo: if grazing_loss { usual.weak_echo } else { 0.0 },
            ..usual
        };
        let config = SimulatorConfig {
            noise,
            motion,
            seed,
            ..SimulatorConfig::default()
        };
        let mut only = tsdfuse_io::Sensor::new(model.name.clone());
        only.model = Some(model.clone());
        let range = tsdfuse_io::Suggested::of(std::slice::from_ref(&only)).range;
        let simulator = Simulator::new(built, model, poses, config).or_raise()?;
        let origin = std::sync::Arc::new(Origin { sensor: only, range });
        Ok(Self {
            simulator,
            origin,
            scene: scene.to_owned(),
        })
    }

    fn __len__(&self) -> usize {
        self.simulator.scans().len()
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Scan> {
        let scans = self.__len__();
        let number = if index < 0 { index + scans as isize } else { index };
        let number = usize::try_from(number).ok().filter(|&number| number < scans);
        // It also ends the iteration.
        let number =
            number.ok_or_else(|| PyIndexError::new_err(format!("no scan {index}: there are {scans} scans")))?;
        let scan = py.detach(|| self.simulator.nth_scan(number));
        let scan = scan.ok_or_else(|| PyIndexError::new_err(format!("no scan {index}")))?;
        Ok(Scan {
            origin: Some(self.origin.clone()),
            ..scan.into()
        })
    }

    /// The true surface.
    fn mesh(&self, py: Python<'_>) -> PyResult<Mesh> {
        let mesh = py.detach(|| self.simulator.scene().mesh(CHORD_M));
        Mesh::of(py, mesh)
    }

    /// The exact signed distance at points.
    fn distance<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let rows = Rows::<f64>::of("points", points)?;
        let points = rows.vectors()?;
        let distances = py.detach(|| {
            points
                .iter()
                .map(|&p| self.simulator.scene().signed_distance(p))
                .collect()
        });
        Ok(PyArray1::from_vec(py, distances))
    }

    /// `world_from_sensor` of each scan.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let poses = &self.simulator.path()[..self.__len__()];
        pose_arrays(py, poses.iter().copied().map(Some))
    }

    fn __repr__(&self) -> String {
        format!(
            "<Simulation of {}: {} scans of {}>",
            self.scene,
            self.__len__(),
            self.simulator.sensor().name
        )
    }
}
