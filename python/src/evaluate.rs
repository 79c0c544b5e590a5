//! How good a mesh, a trajectory or a method is.

use std::path::PathBuf;

use pyo3::prelude::*;
use serde::Deserialize;
use tsdfuse::trajectory::Poses;
use tsdfuse_eval::{Protocol, Reference};
use tsdfuse_evaluate::{Comparing, Contest, Evaluation, Form, Tuning, reference};
use tsdfuse_io::OpenOptions;
use tsdfuse_run::{Input, Settings};

use crate::arrays::Rows;
use crate::data::{from_python, to_python};
use crate::error::{OrRaise, wrong};
use crate::mesh::Mesh;
use crate::trajectory::Trajectory;
use crate::watch::work;

/// Compares a mesh with a reference: a file or a log, a mesh, or points.
#[pyfunction]
#[pyo3(signature = (mesh, reference, *, observed=None, every=1, sensor=None, protocol="surface", thresholds=None, crop=None, samples=None, progress=None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn compare<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    reference: &Bound<'py, PyAny>,
    observed: Option<PathBuf>,
    every: usize,
    sensor: Option<String>,
    protocol: &str,
    thresholds: Option<Vec<f64>>,
    crop: Option<[[f64; 3]; 2]>,
    samples: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let known = Protocol::by_name(protocol);
    let mut rules = known.ok_or_else(|| {
        wrong(format_args!(
            "no protocol {protocol}; there are {}",
            Protocol::NAMES.join(", ")
        ))
    })?;
    rules.thresholds_m = thresholds.unwrap_or(rules.thresholds_m);
    rules.samples = samples.unwrap_or(rules.samples);
    rules.crop = crop.map(|corners| corners.map(glam::DVec3::from));
    rules.check().or_raise()?;
    let mesh = mesh.to_engine(py)?;
    let given = Given::of(py, reference)?;
    let options = OpenOptions {
        sensors: sensor.into_iter().collect(),
        ..OpenOptions::default()
    };
    let found = work(py, progress, |_, teller| {
        let mut reference = match given {
            Given::Path(path) => {
                reference::read(&path, every.max(1), &options, &mut |p| teller.measuring(p)).or_raise()?
            }
            Given::Mesh(mesh) => Reference::mesh(mesh).or_raise()?,
            Given::Points(points) => Reference::cloud(points).or_raise()?,
        };
        if let Some(path) = &observed {
            reference = reference::observed_at(reference, path).or_raise()?;
        }
        tsdfuse_eval::compare(&mesh, &reference, &rules).or_raise()
    })?;
    to_python(py, &found)
}

/// What a mesh is compared with.
enum Given {
    Path(PathBuf),
    Mesh(tsdfuse::Mesh),
    Points(Vec<glam::DVec3>),
}

impl Given {
    fn of(py: Python<'_>, value: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(mesh) = value.cast::<Mesh>() {
            return Ok(Self::Mesh(mesh.get().to_engine(py)?));
        }
        match value.extract::<PathBuf>() {
            Ok(path) => Ok(Self::Path(path)),
            Err(_) => Ok(Self::Points(Rows::<f64>::of("reference", value)?.vectors()?.to_vec())),
        }
    }
}

/// What is asked of an evaluation, as plain data.
#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Asked {
    input: Input,
    settings: Settings,
    methods: Vec<String>,
    method_set: Vec<String>,
    hold_out: Option<usize>,
    margin_m: Option<f64>,
    reference: Option<PathBuf>,
    every: usize,
    protocol: Option<String>,
    samples: Option<usize>,
    runs: usize,
    max_error_m: f64,
    output: Option<PathBuf>,
    keep_meshes: bool,
    /// Seconds for searching the best settings instead.
    tune: Option<f64>,
}

impl Default for Asked {
    fn default() -> Self {
        Self {
            input: Input::default(),
            settings: Settings::default(),
            methods: Vec::new(),
            method_set: Vec::new(),
            hold_out: None,
            margin_m: None,
            reference: None,
            every: 1,
            protocol: None,
            samples: None,
            runs: 1,
            max_error_m: 0.05,
            output: None,
            keep_meshes: false,
            tune: None,
        }
    }
}

/// Compares methods on a log; `start` starts the command, which runs each method in a process of its own.
#[pyfunction]
#[pyo3(signature = (asked, start, progress=None))]
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    asked: &Bound<'py, PyAny>,
    start: Vec<std::ffi::OsString>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let asked: Asked = from_python(asked, "evaluate")?;
    let forms = Form::chosen(&asked.methods, &asked.method_set).or_raise()?;
    let contest = Contest {
        input: asked.input,
        settings: asked.settings,
        forms,
        hold_out: asked.hold_out,
        margin_m: asked.margin_m,
        pose_noise: None,
    };
    if let Some(budget_secs) = asked.tune {
        let tuning = Tuning { contest, budget_secs };
        let found = work(py, progress, |_, teller| {
            tuning.run(&mut |p| teller.measuring(p)).or_raise()
        })?;
        return to_python(py, &found);
    }
    let evaluation = Evaluation {
        comparing: Comparing {
            reference: asked.reference,
            every: asked.every,
            protocol: asked.protocol,
            samples: asked.samples,
        },
        runs: asked.runs,
        max_error_m: asked.max_error_m,
        output: asked.output,
        keep_meshes: asked.keep_meshes,
        command_line: vec!["tsdfuse.evaluate".to_owned()],
        ..Evaluation::of(contest)
    };
    let found = work(py, progress, |_, teller| {
        evaluation
            .run(&mut tsdfuse_cli::in_own_process(start), &mut |p| teller.measuring(p))
            .or_raise()
    })?;
    to_python(py, &found.results)
}

/// Compares two trajectories.
#[pyfunction]
#[pyo3(signature = (trajectory, reference, *, align=true))]
pub(crate) fn compare_trajectories<'py>(
    py: Python<'py>,
    trajectory: &Trajectory,
    reference: &Trajectory,
    align: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let (trajectory, reference) = (track(trajectory), track(reference));
    let found = py
        .detach(|| tsdfuse_eval::trajectory::compare(&trajectory, &reference, align))
        .or_raise()?;
    to_python(py, &found)
}

fn track(trajectory: &Trajectory) -> Poses {
    Poses::of(trajectory.poses.iter().copied())
}
