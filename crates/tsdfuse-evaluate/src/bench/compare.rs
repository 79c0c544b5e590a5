//! Seconds of each stage, method by method.

use std::path::Path;

use tempfile::TempDir;
use tsdfuse_io::Log;
use tsdfuse_run::{Input, Machine, RunConfig, Session, Settings};

use super::changes::Changes;
use super::limits::Limits;
use super::results::{Data, Measured, Results};
use super::run::{self, Run};
use super::street::{self, STREET};
use crate::error::{Error, Result};
use crate::form::Form;
use crate::progress::{Progress, Runs, Watch};
use crate::reference;
use crate::results::Failed;

/// What is measured.
#[derive(Clone, Debug)]
pub struct Bench {
    /// The log and which of its scans; [`STREET`] as its path is a street that is simulated, the same everywhere.
    pub input: Input,
    /// What is set for all methods.
    pub settings: Settings,
    /// The methods. Empty: the one of the settings, or of the log.
    pub forms: Vec<Form>,
    /// Runs of each method. Methods take turns, since a machine is slower at one time than at another.
    pub runs: usize,
    /// The arguments of the program, for the results.
    pub command_line: Vec<String>,
}

impl Default for Bench {
    /// The default method in the simulated street.
    fn default() -> Self {
        Self {
            input: Input {
                path: STREET.into(),
                ..Input::default()
            },
            settings: Settings::default(),
            forms: Vec::new(),
            runs: 5,
            command_line: Vec::new(),
        }
    }
}

/// The log, opened.
pub(crate) struct Opened {
    pub(crate) input: Input,
    pub(crate) log: Log,
    /// Scans that were asked for.
    pub(crate) scans: usize,
    /// Simulated scans vanish when this is dropped.
    _folder: Option<TempDir>,
}

impl Bench {
    /// Runs each method several times, from files to a mesh, and counts what a scan changes in the map.
    ///
    /// # Errors
    /// [`Error::Config`] for options that do not fit together. If no method can be used.
    pub fn run(&self, watch: &mut Watch<'_>) -> Result<Results> {
        self.check()?;
        let opened = self.open(watch)?;
        let Opened { input, log, scans, .. } = &opened;
        let methods = self.methods(log)?;
        watch(Progress::Begun {
            work: "measuring memory",
            steps: None,
        });
        let limits = Limits::measure();
        watch(Progress::Done);
        let mut failed: Vec<(Failed, Error)> = Vec::new();
        let mut measured: Vec<Measured> = Vec::new();
        for (name, config) in methods {
            // The first run tells whether the method can be used at all.
            match Run::time(input, &config, &mut Runs(watch)) {
                Ok(run) => {
                    let mut method = Measured::new(name, config);
                    method.runs.push(run);
                    measured.push(method);
                }
                Err(error) => {
                    let reason = error.to_string();
                    failed.push((Failed { name, reason }, error));
                }
            }
        }
        if measured.is_empty() && !failed.is_empty() {
            return Err(failed.swap_remove(0).1);
        }
        for _ in 1..self.runs {
            for method in &mut measured {
                method.runs.push(Run::time(input, &method.config, &mut Runs(watch))?);
            }
        }
        for method in &mut measured {
            let observer = &mut Runs(watch);
            let session = Session::begin(log, run::setup(input, &method.config), observer)?;
            method.changes = Changes::count(session, *scans, observer)?;
        }
        Ok(Results {
            version: env!("CARGO_PKG_VERSION"),
            command_line: self.command_line.clone(),
            machine: Machine::here(rayon::current_num_threads()),
            dataset: Data {
                name: self.input.path.display().to_string(),
                format: log.format().to_owned(),
                scans: *scans,
            },
            limits,
            methods: measured,
            failed: failed.into_iter().map(|(failed, _)| failed).collect(),
        })
    }

    /// Finds out before the work what cannot be.
    pub(crate) fn check(&self) -> Result<()> {
        self.forms
            .iter()
            .try_for_each(|form| form.over(&self.settings).map(drop))
    }

    /// Opens the log, and simulates it first where none is named.
    pub(crate) fn open(&self, watch: &mut Watch<'_>) -> Result<Opened> {
        let mut input = self.input.clone();
        let mut folder = None;
        if input.path == Path::new(STREET) {
            let simulated = street::write(watch)?;
            simulated.path().clone_into(&mut input.path);
            folder = Some(simulated);
        }
        let log = input.open(&self.settings, &mut Runs(watch))?;
        let scans = input.selection.indices(reference::length(&log)?).len();
        Ok(Opened {
            input,
            log,
            scans,
            _folder: folder,
        })
    }

    /// The methods by name, with all their settings.
    pub(crate) fn methods(&self, log: &Log) -> Result<Vec<(String, RunConfig)>> {
        if self.forms.is_empty() {
            let config = self.settings.resolve(log)?;
            return Ok(vec![(config.method.name().to_owned(), config)]);
        }
        let method = |form: &Form| Ok((form.name.clone(), form.over(&self.settings)?.resolve(log)?));
        self.forms.iter().map(method).collect()
    }
}
