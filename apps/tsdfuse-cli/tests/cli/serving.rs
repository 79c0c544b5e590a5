//! Commands that stay open.

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStderr};

use crate::run::command;

/// A command that serves something until it is dropped.
pub(crate) struct Serving {
    process: Child,
    pub(crate) url: String,
    told: std::io::Lines<BufReader<ChildStderr>>,
}

impl Serving {
    /// Starts it; its URL stands behind this word.
    pub(crate) fn start(arguments: &[&str], word: &str) -> Self {
        let mut process = command(arguments).spawn().unwrap();
        let mut told = BufReader::new(process.stderr.take().unwrap()).lines();
        let mut lines = Vec::new();
        let url = told.by_ref().find_map(|line| {
            lines.push(line.ok()?);
            Some(lines.last()?.trim().strip_prefix(word)?.trim().to_owned())
        });
        assert!(url.is_some(), "no URL in {lines:?}");
        let url = url.unwrap();
        Self { process, url, told }
    }

    /// Interrupts it, and waits for its end.
    #[cfg(unix)]
    pub(crate) fn interrupt(mut self) -> (i32, Vec<String>) {
        let pid = self.process.id().to_string();
        std::process::Command::new("kill")
            .args(["-INT", &pid])
            .status()
            .unwrap();
        let code = self.process.wait().unwrap().code().unwrap();
        (code, self.told.by_ref().map_while(Result::ok).collect())
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
