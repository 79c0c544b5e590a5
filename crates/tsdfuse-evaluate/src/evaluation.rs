//! What an evaluation is asked for, and what comes of it.

use std::path::PathBuf;

use tsdfuse::glam::DVec3;
use tsdfuse_run::{Input, Job, Report, Settings, Silent, Stop};

use crate::error::{Error, Result};
use crate::form::Form;
use crate::results::Results;
use crate::truth::Comparing;

/// Runs a job, anywhere, and says what came of it: the report, or why there is none.
pub type Runner<'a> = dyn FnMut(&Job) -> Result<Report, String> + 'a;

/// Runs jobs in this process. Then the peak of the memory is that of all of them.
pub fn in_this_process() -> impl FnMut(&Job) -> Result<Report, String> {
    |job| {
        job.run(&Stop::default(), &mut Silent)
            .map_err(|error| error.to_string())
    }
}

/// What is compared, and how.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// The log and which of its scans.
    pub input: Input,
    /// What is set for all methods.
    pub settings: Settings,
    /// The methods.
    pub forms: Vec<Form>,
    /// One of so many scans is held out; 0: none. `None`: one of 10, or fewer where there are fewer scans.
    pub hold_out: Option<usize>,
    /// Largest distance between a held-out return and its surface, metres, metres. `None`: the default truncation for the log.
    pub margin_m: Option<f64>,
    /// What meshes are compared with.
    pub comparing: Comparing,
    /// Runs of each method, whose median speed counts. Methods take turns, since a machine is slower at one time than at another.
    pub runs: usize,
    /// The places of the pictures and what is in their middle, world, metres. Empty: from above and twice from the sensor.
    pub views: Vec<[DVec3; 2]>,
    /// The error at the bright end of the colours, metres.
    pub max_error_m: f64,
    /// The file that some of the settings were read from, which no result may overwrite.
    pub config_file: Option<PathBuf>,
    /// The folder for the results.
    pub output: Option<PathBuf>,
    /// Whether meshes stay there.
    pub keep_meshes: bool,
    /// The arguments of the program, for the results.
    pub command_line: Vec<String>,
}

/// What came of it.
#[derive(Debug)]
pub struct Evaluated {
    /// All figures.
    pub results: Results,
    /// The files that were written.
    pub files: Vec<PathBuf>,
    /// What the rows of the picture of all methods show.
    pub sheet_rows: String,
}

impl Evaluation {
    /// All methods on all scans of a log; three runs each, no files.
    pub fn of(log: impl Into<PathBuf>) -> Self {
        Self {
            input: Input {
                path: log.into(),
                ..Input::default()
            },
            settings: Settings::default(),
            forms: Form::all(),
            hold_out: None,
            margin_m: None,
            comparing: Comparing::default(),
            runs: 3,
            views: Vec::new(),
            max_error_m: 0.05,
            config_file: None,
            output: None,
            keep_meshes: false,
            command_line: Vec::new(),
        }
    }

    /// Finds out before the work what cannot be.
    pub(crate) fn check(&self) -> Result<()> {
        for form in &self.forms {
            form.over(&self.settings)?;
        }
        self.comparing.check()?;
        check_length("--max-error", self.max_error_m)?;
        self.margin_m
            .map_or(Ok(()), |margin_m| check_length("--margin", margin_m))
    }

    /// The names of all files of results.
    pub(crate) fn files(&self) -> Vec<String> {
        let meshes = self.forms.iter().map(Form::mesh_name).filter(|_| self.keep_meshes);
        let files = ["results.json", "table.md", "report.html", "methods.png"];
        files.map(str::to_owned).into_iter().chain(meshes).collect()
    }
}

/// Refuses what is no length.
pub(crate) fn check_length(flag: &str, length_m: f64) -> Result<()> {
    if length_m > 0.0 && length_m.is_finite() {
        return Ok(());
    }
    Err(Error::config(format_args!(
        "{flag} must be a positive length in metres, not {length_m}"
    )))
}
