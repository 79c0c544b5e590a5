//! One method in a process of its own, so that its memory is its own: `tsdfuse fuse --report`, run and read.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use tsdfuse::scan::Dropped;

use super::forms::Form;
use crate::config::RunConfig;
use crate::settings::Settings;

/// What is read of a report: see [`crate::report::Report`].
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct FuseReport {
    pub(crate) threads: usize,
    pub(crate) config: RunConfig,
    pub(crate) scans: Vec<ScanTimes>,
    pub(crate) skipped_scans: Vec<Skipped>,
    pub(crate) totals: Totals,
    pub(crate) map: Map,
    pub(crate) mesh: Option<MeshSize>,
    pub(crate) peak_memory_bytes: Option<u64>,
}

/// A scan's seconds of wall time.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct ScanTimes {
    pub(crate) read: f64,
    pub(crate) prepare: f64,
    pub(crate) fuse: f64,
}

/// A scan that could not be fused.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Skipped {
    pub(crate) name: String,
    pub(crate) reason: String,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct Totals {
    pub(crate) points: u64,
    pub(crate) fused: u64,
    pub(crate) dropped: Dropped,
    pub(crate) finish: Finish,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct Finish {
    pub(crate) seconds: f64,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct Map {
    pub(crate) blocks: usize,
    pub(crate) bytes: u64,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct MeshSize {
    pub(crate) triangles: usize,
    pub(crate) seconds: f64,
}

/// What one run is to leave behind.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Wanted<'a> {
    pub(crate) mesh: Option<&'a Path>,
    pub(crate) map: Option<&'a Path>,
    pub(crate) hold_out: Option<u32>,
}

/// Fuses in a new process and reads its report, which is written to `report`.
pub(crate) fn fuse(settings: &Settings, form: &Form, wanted: Wanted, report: &Path) -> Result<FuseReport> {
    let mut arguments: Vec<OsString> = vec!["fuse".into(), settings.dataset.clone().into()];
    arguments.extend(settings.arguments());
    arguments.extend(form.arguments().into_iter().map(OsString::from));
    for (flag, path) in [
        ("--output", wanted.mesh),
        ("--save-map", wanted.map),
        ("--report", Some(report)),
    ] {
        arguments.extend(
            path.into_iter()
                .flat_map(|path| [flag.into(), path.as_os_str().to_owned()]),
        );
    }
    if let Some(every) = wanted.hold_out {
        arguments.extend(["--hold-out".into(), every.to_string().into()]);
    }
    let program = std::env::current_exe().context("this program's own file")?;
    let done = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .context("tsdfuse fuse")?;
    // 3: scans were skipped, as the report says.
    if !matches!(done.status.code(), Some(0 | 3)) {
        let told = String::from_utf8_lossy(&done.stderr);
        match told
            .lines()
            .rev()
            .find_map(|line| line.strip_prefix("tsdfuse: error: "))
        {
            Some(reason) => bail!("{reason}"),
            None => bail!(
                "tsdfuse fuse ended with {}: {}",
                done.status,
                told.lines().last().unwrap_or_default()
            ),
        }
    }
    let text = std::fs::read(report).with_context(|| report.display().to_string())?;
    serde_json::from_slice(&text).with_context(|| report.display().to_string())
}
