//! What an evaluation is asked for, and what comes of it.

use std::path::PathBuf;

use tsdfuse::glam::DVec3;
use tsdfuse_run::{Job, Report, Silent, Stop};

use crate::contest::{Contest, check_length};
use crate::error::Result;
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
    /// The methods and the data. One of 10 scans is held out, unless that is set; or fewer where there are fewer scans.
    pub contest: Contest,
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
    /// Three runs of each method, no files.
    pub fn of(contest: Contest) -> Self {
        Self {
            contest,
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
        self.contest.check()?;
        self.comparing.check()?;
        check_length("--max-error", self.max_error_m)
    }

    /// The names of all files of results.
    pub(crate) fn files(&self) -> Vec<String> {
        let meshes = self
            .contest
            .forms
            .iter()
            .map(Form::mesh_name)
            .filter(|_| self.keep_meshes);
        let files = ["results.json", "table.md", "report.html", "methods.png"];
        files.map(str::to_owned).into_iter().chain(meshes).collect()
    }
}
