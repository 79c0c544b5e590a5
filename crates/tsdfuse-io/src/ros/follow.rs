//! A recording that is still being written, or that comes through standard input: its scans in order, as they come.
//!
//! The index is made anew when the file has grown: after at least [`SHARE`] times as long as making it took, so that most of the time
//! is left for what is done with the scans, however long the recording gets. Scans of the last [`HELD_BACK_SECS`] wait for what may
//! belong to them: the rest of their packets, and poses. Standard input is copied into a temporary file as it comes. So either can be read again in
//! the end.
//!
//! The end is that of standard input, the end mark of MCAP, or [`SILENCE_SECS`] without a new byte.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};

use tempfile::NamedTempFile;
use tsdfuse::trajectory::ns_after;

use super::mcap;
use super::recording::Recording;
use crate::error::{Error, Result};
use crate::files;
use crate::source::{Kept, News, OpenOptions, Sensor, Source, Stream, StreamedScan};

/// Seconds without a new byte after which a recording is taken to be at its end.
const SILENCE_SECS: u64 = if cfg!(test) { 3 } else { 10 };
/// Scans so near to the newest one wait for more.
const HELD_BACK_SECS: f64 = 0.5;
/// With fewer scans, units and references of times are not concluded yet.
const FIRST_SCANS: usize = 8;
const SHARE: u32 = 4;
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A recording that grows.
pub(crate) struct Follow {
    format: String,
    path: PathBuf,
    options: OpenOptions,
    spool: Option<Spool>,
    recording: Recording,
    notes: Vec<String>,
    /// How long the recording was when its index was made, when that was, and how long it took.
    indexed: Indexed,
    /// Time and sensor of the last scan that was handed out.
    last: Option<(i64, usize)>,
    /// No more comes.
    is_over: bool,
}

#[derive(Clone, Copy)]
struct Indexed {
    bytes: u64,
    at: Instant,
    took: Duration,
    /// Whether it was at its end then.
    is_whole: bool,
}

/// Standard input, on its way into a file.
struct Spool {
    file: Arc<NamedTempFile>,
    is_over: Arc<AtomicBool>,
    news: News,
}

impl Spool {
    fn start(mut input: impl Read + Send + 'static) -> Result<Self> {
        let error = |e| Error::io("standard input")(e);
        let file = NamedTempFile::new().map_err(error)?;
        let mut copy = file.reopen().map_err(error)?;
        let (is_over, news) = (Arc::new(AtomicBool::new(false)), News::default());
        let (flag, tell, path) = (is_over.clone(), news.clone(), file.path().to_owned());
        let run = move || {
            // What came before an error is read.
            if let Err(error) = std::io::copy(&mut input, &mut copy) {
                let sentence = format!("standard input: its copy, {}, is not whole: {error}", path.display());
                tell.lock().unwrap_or_else(PoisonError::into_inner).push(sentence);
            }
            flag.store(true, Ordering::Release);
        };
        Builder::new().name("read-stdin".to_owned()).spawn(run).map_err(error)?;
        Ok(Self {
            file: Arc::new(file),
            is_over,
            news,
        })
    }
}

impl Follow {
    /// Follows a file or a folder, and waits for its first scans.
    ///
    /// # Errors
    /// Names it, if nothing that can be read comes.
    pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Self> {
        Self::start(path.to_owned(), None, options)
    }

    /// Reads standard input.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(crate) fn stdin(options: &OpenOptions) -> Result<Self> {
        Self::read(std::io::stdin(), options)
    }

    pub(super) fn read(input: impl Read + Send + 'static, options: &OpenOptions) -> Result<Self> {
        let spool = Spool::start(input)?;
        Self::start(spool.file.path().to_owned(), Some(spool), options)
    }

    fn start(path: PathBuf, spool: Option<Spool>, options: &OpenOptions) -> Result<Self> {
        let mut grown = Instant::now();
        let mut bytes = 0;
        let mut next_try = Instant::now();
        loop {
            let is_whole = is_whole(&path, spool.as_ref());
            let now = size(&path);
            if now > bytes {
                (bytes, grown) = (now, Instant::now());
            }
            let is_over = is_whole || grown.elapsed().as_secs() >= SILENCE_SECS;
            if is_over || Instant::now() >= next_try {
                let begin = Instant::now();
                let opened = Recording::open(&path, options);
                let indexed = Indexed {
                    bytes: now,
                    at: Instant::now(),
                    took: begin.elapsed(),
                    is_whole,
                };
                next_try = Instant::now() + indexed.took * SHARE;
                match opened {
                    Ok(recording) if is_over || recording.scans().len() >= FIRST_SCANS => {
                        return Ok(Self {
                            format: format!("{}, as it grows", recording.format()),
                            notes: recording.notes().to_vec(),
                            options: OpenOptions {
                                // The same ones in the same order, whatever comes.
                                sensors: recording.sensors().iter().map(|sensor| sensor.name.clone()).collect(),
                                ..options.clone()
                            },
                            path,
                            spool,
                            recording,
                            indexed,
                            last: None,
                            is_over,
                        });
                    }
                    Err(error) if is_over => return Err(error),
                    _ => {}
                }
            }
            thread::sleep(LOOK_EVERY);
        }
    }

    /// The next scan that need not wait for more.
    fn ready(&self) -> Option<usize> {
        let scans = self.recording.scans();
        let newest = scans.iter().filter_map(|scan| scan.time_ns).max()?;
        let until = if self.is_over {
            i64::MAX
        } else {
            ns_after(newest, -HELD_BACK_SECS)
        };
        let of = |index: usize| scans[index].time_ns.map(|time_ns| (time_ns, scans[index].sensor));
        let next = (0..scans.len())
            .filter(|&index| of(index) > self.last)
            .min_by_key(|&index| of(index))?;
        of(next).is_some_and(|(time_ns, _)| time_ns <= until).then_some(next)
    }

    /// Waits until there is more, or the end.
    fn grow(&mut self) -> Result<()> {
        let mut grown = Instant::now();
        let mut bytes = size(&self.path);
        loop {
            let is_whole = is_whole(&self.path, self.spool.as_ref());
            let now = size(&self.path);
            if now > bytes {
                (bytes, grown) = (now, Instant::now());
            }
            let is_new = now > self.indexed.bytes || is_whole && !self.indexed.is_whole;
            if is_new && (is_whole || self.indexed.at.elapsed() >= self.indexed.took * SHARE) {
                let begin = Instant::now();
                let opened = Recording::open(&self.path, &self.options);
                self.indexed = Indexed {
                    bytes: now,
                    at: Instant::now(),
                    took: begin.elapsed(),
                    is_whole,
                };
                match opened {
                    Ok(recording) => {
                        self.recording = recording;
                        self.is_over = is_whole;
                        return Ok(());
                    }
                    // An index may be half written.
                    Err(error) if is_whole => return Err(error),
                    Err(_) => {}
                }
            }
            if is_whole || grown.elapsed().as_secs() >= SILENCE_SECS {
                self.is_over = true;
                return Ok(());
            }
            thread::sleep(LOOK_EVERY);
        }
    }
}

/// Bytes of a file, or of the files in a folder; a SQLite bag may grow in a file beside it.
fn size(path: &Path) -> u64 {
    let of = |path: &Path| std::fs::metadata(path).map_or(0, |data| data.len());
    if path.is_dir() {
        let names = files::names(path).unwrap_or_default();
        return names.iter().map(|name| of(&path.join(name))).sum();
    }
    let mut beside = path.as_os_str().to_owned();
    beside.push("-wal");
    of(path) + of(Path::new(&beside))
}

/// Whether no more can come: standard input is over, or MCAP's end mark is there.
fn is_whole(path: &Path, spool: Option<&Spool>) -> bool {
    if let Some(spool) = spool {
        return spool.is_over.load(Ordering::Acquire);
    }
    let mut ends = [[0; 8]; 2];
    let read = |mut file: File| -> std::io::Result<()> {
        file.read_exact(&mut ends[0])?;
        // The first mark is not the last one.
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(8).max(8)))?;
        file.read_exact(&mut ends[1])
    };
    path.is_file() && File::open(path).and_then(read).is_ok() && ends == [mcap::MAGIC, mcap::MAGIC]
}

impl Stream for Follow {
    fn format(&self) -> &str {
        &self.format
    }

    fn sensors(&self) -> &[Sensor] {
        self.recording.sensors()
    }

    fn next(&mut self) -> Option<StreamedScan> {
        loop {
            if let Some(index) = self.ready() {
                let reference = &self.recording.scans()[index];
                self.last = reference.time_ns.map(|time_ns| (time_ns, reference.sensor));
                return Some(StreamedScan {
                    sensor: reference.sensor,
                    scan: self.recording.read(index),
                });
            }
            if self.is_over {
                return None;
            }
            if let Err(error) = self.grow() {
                self.is_over = true;
                return Some(StreamedScan {
                    sensor: 0,
                    scan: Err(error),
                });
            }
        }
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn news(&self) -> News {
        let news = self.spool.as_ref().map(|spool| spool.news.clone());
        news.unwrap_or_default()
    }

    fn kept(&self) -> Option<Arc<dyn Kept>> {
        Some(Arc::new(Written {
            path: self.path.clone(),
            spool: self.spool.as_ref().map(|spool| spool.file.clone()),
        }))
    }

    fn is_placed(&self) -> bool {
        self.recording.scans().iter().any(|scan| scan.pose.is_some())
    }
}

/// A recording is a file already.
struct Written {
    path: PathBuf,
    spool: Option<Arc<NamedTempFile>>,
}

impl Kept for Written {
    fn keep(&self, _: &Path) -> Result<()> {
        Ok(())
    }

    fn recording(&self) -> Result<PathBuf> {
        Ok(self.path.clone())
    }

    fn forget(&self) {
        if let Some(spool) = &self.spool {
            // It may be gone already.
            let _ = std::fs::remove_file(spool.path());
        }
    }
}
