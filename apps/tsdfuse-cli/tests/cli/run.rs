//! Runs the command and keeps what it said.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

/// What a run of the command came to.
#[derive(Debug)]
pub(crate) struct Run {
    pub(crate) code: i32,
    pub(crate) stdout: Vec<u8>,
    pub(crate) stderr: String,
}

/// The command, not yet started; not on a terminal.
pub(crate) fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tsdfuse"));
    command
        .args(arguments)
        .env_remove("COLUMNS")
        .env("XDG_RUNTIME_DIR", std::env::temp_dir()) // without it Mesa adds lines to what is told
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// Runs the command; a panic is never right.
pub(crate) fn tsdfuse(arguments: &[&str]) -> Run {
    let Output { status, stdout, stderr } = command(arguments).output().unwrap();
    let stderr = String::from_utf8(stderr).unwrap();
    assert!(!stderr.contains("panicked"), "{arguments:?}: {stderr}");
    Run {
        code: status.code().unwrap(),
        stdout,
        stderr,
    }
}

impl Run {
    /// Asserts that all went well.
    pub(crate) fn succeeded(self) -> Self {
        assert_eq!(self.code, 0, "{}", self.stderr);
        self
    }

    /// Asserts the exit code and a single line of error; returns that line.
    pub(crate) fn failed(self, code: i32) -> String {
        assert_eq!(self.code, code, "{}", self.stderr);
        assert_eq!(self.stderr.lines().count(), 1, "{}", self.stderr);
        assert!(self.stderr.starts_with("tsdfuse: error: "), "{}", self.stderr);
        assert!(self.stdout.is_empty());
        self.stderr
    }

    /// What it printed as JSON.
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.stdout).unwrap()
    }
}

/// A folder for one test, gone afterwards.
pub(crate) struct Folder(TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// Simulates a sequence into `name`, without noise unless `more` asks for it.
    pub(crate) fn simulate(&self, name: &str, scene: &str, sensor: &str, scans: u32, more: &[&str]) -> String {
        let (folder, scans) = (self.text(name), scans.to_string());
        let mut arguments = vec![
            "simulate", "--scene", scene, "--sensor", sensor, "--scans", &scans, "-o", &folder,
        ];
        arguments.extend(more);
        for (flag, value) in [("--noise", "0"), ("--dropout", "0"), ("--grazing-loss", "off")] {
            if !more.contains(&flag) {
                arguments.extend([flag, value]);
            }
        }
        tsdfuse(&arguments).succeeded();
        folder
    }
}

/// The names in a folder, sorted, hidden ones included.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The interpreter that `TSDFUSE_PYTHON` names, if it has these modules.
#[allow(clippy::print_stderr)]
pub(crate) fn python(modules: &str) -> Option<String> {
    let python = std::env::var("TSDFUSE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let found = Command::new(&python)
        .args(["-c", &format!("import {modules}")])
        .output();
    if found.is_ok_and(|run| run.status.success()) {
        return Some(python);
    }
    let is_asked = std::env::var_os("TSDFUSE_PYTHON").is_some();
    assert!(!is_asked, "{python} cannot import {modules}");
    eprintln!("SKIPPED: {python} cannot import {modules}; TSDFUSE_PYTHON names another one");
    None
}
