//! Reading the next scans while the caller works on this one.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use tsdfuse::Scan;

use crate::dataset::Dataset;
use crate::error::{Error, Result};

/// Threads that read; each holds at most one scan until the caller takes it.
const LANES: usize = 2;

/// One scan as it comes from [`ReadAhead`].
#[derive(Debug)]
pub struct ReadScan {
    /// Its number in the data set.
    pub index: usize,
    /// The scan, or why it could not be read.
    pub scan: Result<Scan>,
    /// Seconds of wall time that reading and decoding took (in the background).
    pub read_secs: f64,
}

/// Scans in the order asked for, the next two being read in the background.
///
/// Lane k reads the k-th, (k+2)-th, … scan and waits until it is taken, so that no more than two scans wait in memory.
/// Dropping the iterator ends both lanes; a read that has begun is waited for. A scan that cannot be read does not end
/// the iteration.
#[derive(Debug)]
pub struct ReadAhead {
    dataset: Dataset,
    indices: Arc<[usize]>,
    next: usize,
    lanes: Vec<Lane>,
}

#[derive(Debug)]
struct Lane {
    scans: Receiver<ReadScan>,
    thread: JoinHandle<()>,
}

impl ReadAhead {
    pub(crate) fn new(dataset: Dataset, indices: Vec<usize>) -> Self {
        let indices: Arc<[usize]> = indices.into();
        // Without threads (a system that refuses more of them) scans are read when they are asked for.
        let lanes: Option<Vec<_>> = (0..LANES.min(indices.len()))
            .map(|lane| Lane::spawn(lane, dataset.clone(), indices.clone()).ok())
            .collect();
        Self {
            dataset,
            indices,
            next: 0,
            lanes: lanes.unwrap_or_default(),
        }
    }
}

impl Lane {
    fn spawn(lane: usize, dataset: Dataset, indices: Arc<[usize]>) -> std::io::Result<Self> {
        let (sender, scans) = sync_channel(0);
        let thread = Builder::new().name(format!("read-{lane}")).spawn(move || {
            for &index in indices.iter().skip(lane).step_by(LANES) {
                if sender.send(read(&dataset, index)).is_err() {
                    return; // nobody wants more
                }
            }
        })?;
        Ok(Self { scans, thread })
    }
}

fn read(dataset: &Dataset, index: usize) -> ReadScan {
    let start = Instant::now();
    let scan = dataset.read(index);
    ReadScan {
        index,
        scan,
        read_secs: start.elapsed().as_secs_f64(),
    }
}

impl Iterator for ReadAhead {
    type Item = ReadScan;

    fn next(&mut self) -> Option<ReadScan> {
        let index = *self.indices.get(self.next)?;
        let lane = self.lanes.get(self.next % LANES);
        self.next += 1;
        Some(match lane {
            None => read(&self.dataset, index),
            Some(lane) => lane.scans.recv().unwrap_or_else(|_| ReadScan {
                index,
                scan: Err(Error::dataset(
                    self.dataset.scans().get(index).map_or("", |s| s.name.as_str()),
                    "the thread that was to read it has died",
                )),
                read_secs: 0.0,
            }),
        })
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.indices.len() - self.next;
        (left, Some(left))
    }
}

impl ExactSizeIterator for ReadAhead {}

impl Drop for ReadAhead {
    fn drop(&mut self) {
        for Lane { scans, thread } in self.lanes.drain(..) {
            drop(scans);
            // A lane that panicked has been reported by `next`.
            let _ = thread.join();
        }
    }
}

/// All scans of a data set in order: what `for scan in dataset` runs through. Reads ahead as [`ReadAhead`] does.
#[derive(Debug)]
pub struct Scans(ReadAhead);

impl Scans {
    pub(crate) fn new(scans: ReadAhead) -> Self {
        Self(scans)
    }
}

impl Iterator for Scans {
    type Item = Result<Scan>;

    fn next(&mut self) -> Option<Result<Scan>> {
        self.0.next().map(|s| s.scan)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.0.size_hint()
    }
}

impl ExactSizeIterator for Scans {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{ScanRef, Source};
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;
    use tsdfuse::Pose;

    /// Twenty scans; counts the reads; scan 7 is broken, scan 9 panics.
    struct Counting {
        scans: Vec<ScanRef>,
        reads: Arc<AtomicUsize>,
    }

    impl Source for Counting {
        fn format(&self) -> &'static str {
            "counting"
        }
        fn scans(&self) -> &[ScanRef] {
            &self.scans
        }
        fn read(&self, index: usize) -> Result<Scan> {
            self.reads.fetch_add(1, Ordering::SeqCst);
            assert_ne!(index, 9, "on purpose");
            // Odd scans take longer: the order must not depend on it.
            std::thread::sleep(Duration::from_millis(3 * (index % 2) as u64));
            if index == 7 {
                return Err(Error::format("7.bin", "broken"));
            }
            Ok(Scan {
                name: index.to_string(),
                ..Default::default()
            })
        }
    }

    fn dataset() -> (Dataset, Arc<AtomicUsize>) {
        let reads = Arc::new(AtomicUsize::new(0));
        let scans = (0..20)
            .map(|i| ScanRef {
                name: format!("{i}.bin"),
                timestamp_secs: None,
                pose: Pose::IDENTITY,
            })
            .collect();
        let source = Counting {
            scans,
            reads: reads.clone(),
        };
        (Dataset::new(source), reads)
    }

    #[test]
    fn scans_come_in_order_and_a_broken_one_does_not_end_the_run() {
        let (dataset, _) = dataset();
        let read: Vec<_> = dataset.iter_range(0..9, 1).collect();
        assert_eq!(
            read.iter().map(|s| s.index).collect::<Vec<_>>(),
            (0..9).collect::<Vec<_>>()
        );
        for s in &read {
            match &s.scan {
                Ok(scan) => assert_eq!(scan.name, s.index.to_string()),
                Err(e) => assert_eq!((s.index, e.to_string().as_str()), (7, "7.bin: broken")),
            }
        }
        assert!(read[1].read_secs >= 0.003 && read[1].read_secs < 1.0);
    }

    #[test]
    fn a_range_is_clamped_and_stepped() {
        let (dataset, _) = dataset();
        let numbers = |range, step| dataset.iter_range(range, step).map(|s| s.index).collect::<Vec<_>>();
        assert_eq!(numbers(10..99, 4), [10, 14, 18]);
        assert_eq!(numbers(3..5, 0), [3, 4]);
        assert_eq!(numbers(30..40, 1), [0; 0]);
    }

    #[test]
    fn no_more_than_two_scans_wait_and_dropping_stops_the_reading() {
        let (dataset, reads) = dataset();
        let mut scans = dataset.iter_range(0..20, 1);
        assert_eq!(scans.next().map(|s| s.index), Some(0));
        std::thread::sleep(Duration::from_millis(100));
        assert_eq!(reads.load(Ordering::SeqCst), 3);
        drop(scans);
        assert_eq!(reads.load(Ordering::SeqCst), 3);
    }

    #[test]
    fn a_reader_that_panics_is_reported_by_name() {
        let (dataset, _) = dataset();
        let read: Vec<_> = dataset.iter_indices(vec![8, 9, 10]).collect();
        assert!(read[0].scan.is_ok() && read[2].scan.is_ok());
        let message = read[1].scan.as_ref().unwrap_err().to_string();
        assert_eq!(message, "9.bin: the thread that was to read it has died");
    }
}
