//! Long work: on a thread of its own and without the interpreter, while the thread that asked for it tells Python how far it is, and
//! listens for Ctrl-C.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use tsdfuse_evaluate::Progress;
use tsdfuse_run::{Event, Observer, Stop};

/// How long Ctrl-C waits at most.
const PATIENCE: Duration = Duration::from_millis(50);

/// Something to tell Python.
enum News {
    /// Of `total` steps, where that is known, `done` are done; `what` is the last one, or what goes on now.
    Progress {
        done: usize,
        total: Option<usize>,
        what: String,
    },
    /// A sentence about something unusual.
    Note(String),
}

/// Tells Python, through the thread that waits.
pub(crate) struct Teller {
    news: Sender<News>,
    done: usize,
    total: Option<usize>,
}

impl Teller {
    fn progress(&self, what: &str) {
        // If nobody listens any more, nobody wants to know.
        let (done, total) = (self.done, self.total);
        let _ = self.news.send(News::Progress {
            done,
            total,
            what: what.to_owned(),
        });
    }

    fn note(&self, sentence: impl Into<String>) {
        let _ = self.news.send(News::Note(sentence.into()));
    }

    /// What a measurement tells.
    pub(crate) fn measuring(&mut self, progress: Progress<'_>) {
        match progress {
            Progress::Begun { work, steps } => {
                (self.done, self.total) = (0, steps);
                self.progress(work);
            }
            Progress::At(step) => self.progress(step),
            Progress::Step => {
                self.done += 1;
                self.progress("");
            }
            Progress::Note(sentence) => self.note(sentence),
            Progress::Run(event) => self.on(event),
            _ => {}
        }
    }
}

impl Observer for Teller {
    fn on(&mut self, event: Event<'_>) {
        match event {
            Event::Begun { scans, done, .. } => {
                (self.done, self.total) = (done, scans);
                self.progress("");
            }
            Event::ScanFused { report, .. } => {
                self.done += 1;
                self.progress(&report.name);
            }
            Event::ScanSkipped { skipped, .. } => {
                self.done += 1;
                self.note(format!("skipped {}: {}", skipped.name, skipped.reason));
                self.progress(&skipped.name);
            }
            Event::Working(what) => self.progress(what),
            Event::Note(sentence) => self.note(sentence),
            Event::OverLimit { bytes } => {
                self.note(format!(
                    "what one scan can touch takes {bytes} bytes, more than the limit"
                ));
            }
            _ => {}
        }
    }
}

/// Works without the interpreter; `progress(done, total, what)` is called meanwhile, on this thread. Ctrl-C, and an exception of
/// `progress`, stop the work where it looks at its [`Stop`], and are raised when it has ended.
pub(crate) fn work<T: Send>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&Stop, &mut Teller) -> PyResult<T> + Send,
) -> PyResult<T> {
    let stop = Stop::default();
    let (news, heard) = mpsc::channel();
    py.detach(move || {
        thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let mut teller = Teller {
                    news,
                    done: 0,
                    total: None,
                };
                work(&stop, &mut teller)
            });
            let mut raised = None;
            loop {
                let news = match heard.recv_timeout(PATIENCE) {
                    Ok(news) => Some(news),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) => break,
                };
                if raised.is_none()
                    && let Err(error) = Python::attach(|py| tell(py, progress.as_ref(), news))
                {
                    stop.stop();
                    raised = Some(error);
                }
            }
            let done = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            raised.map_or(done, Err)
        })
    })
}

fn tell(py: Python<'_>, progress: Option<&Py<PyAny>>, news: Option<News>) -> PyResult<()> {
    py.check_signals()?;
    match (news, progress) {
        (Some(News::Progress { done, total, what }), Some(progress)) => {
            progress.call1(py, (done, total, what))?;
        }
        (Some(News::Note(sentence)), _) => {
            let logger = py.import("logging")?.call_method1("getLogger", ("tsdfuse",))?;
            logger.call_method1("warning", ("%s", sentence))?;
        }
        _ => {}
    }
    Ok(())
}
