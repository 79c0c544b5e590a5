//! Reading the next scans while the caller works on this one.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use tsdfuse::Scan;
use tsdfuse::scan::RangeLimits;

use crate::error::{Error, Result};
use crate::selection::Selection;
use crate::source::{ImuSample, Kept, News, OpenOptions, Sensor, Source, Stream, StreamedScan, checked, read_checked};

/// Threads that read from a source; each holds at most one scan until the caller takes it.
const LANES: usize = 2;
/// How often somebody who waits for a stream looks whether to stop.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// One scan as it comes from [`ReadAhead`].
#[derive(Debug)]
pub struct ReadScan {
    /// Its number in the log.
    pub index: usize,
    /// The sensor that measured it: an index into the log's sensors.
    pub sensor: usize,
    /// The scan, or why it could not be read.
    pub scan: Result<Scan>,
    /// Samples of a stream's inertial measurement unit that came before the scan was complete, in the log's body frame.
    pub imu: Vec<ImuSample>,
    /// Seconds of wall time that reading and decoding took (in the background); of a stream also waiting for it.
    pub read_secs: f64,
}

/// A stream, and what is known of it before it is read.
pub(crate) struct Live {
    pub(crate) format: String,
    pub(crate) sensors: Vec<Sensor>,
    pub(crate) notes: Vec<String>,
    pub(crate) news: News,
    pub(crate) is_placed: bool,
    pub(crate) kept: Option<Arc<dyn Kept>>,
    /// How it was opened.
    pub(crate) options: OpenOptions,
    /// `None` once somebody reads it.
    stream: Mutex<Option<Box<dyn Stream>>>,
}

impl Live {
    pub(crate) fn new(stream: impl Stream + 'static) -> Self {
        Self {
            format: stream.format().to_owned(),
            sensors: stream.sensors().to_vec(),
            notes: stream.notes().to_vec(),
            news: stream.news(),
            is_placed: stream.is_placed(),
            kept: stream.kept(),
            options: OpenOptions::default(),
            stream: Mutex::new(Some(Box::new(stream))),
        }
    }

    fn take(&self) -> Option<Box<dyn Stream>> {
        self.stream.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        if let Some(kept) = &self.kept {
            kept.forget();
        }
    }
}

/// Scans in order, the next two being read in the background. A scan that cannot be read does not end the iteration.
///
/// From a source, lane k reads the k-th, (k+2)-th, … scan and waits until it is taken, so that no more than two scans wait
/// in memory. Dropping the iterator ends both lanes; a read that has begun is waited for. From a stream, one thread reads,
/// and also no more than two scans wait; dropping the iterator does not wait for the stream.
#[derive(Debug)]
pub struct ReadAhead(Way);

#[derive(Debug)]
enum Way {
    Source(Lanes),
    Stream(Pipe),
    /// These cannot be read; of what format, and why.
    Refused(std::vec::IntoIter<usize>, [String; 2]),
}

impl ReadAhead {
    pub(crate) fn of_source(source: Arc<dyn Source>, indices: Vec<usize>) -> Self {
        Self(Way::Source(Lanes::new(source, indices)))
    }

    pub(crate) fn of_stream(live: &Arc<Live>, selection: Selection) -> Self {
        match live.take() {
            Some(stream) => match Pipe::new(live, stream, selection) {
                Ok(pipe) => Self(Way::Stream(pipe)),
                Err(e) => Self(Way::Refused(vec![0].into_iter(), [live.format.clone(), e.to_string()])),
            },
            None => Self::refused(live, vec![selection.from]),
        }
    }

    pub(crate) fn refused(live: &Live, indices: Vec<usize>) -> Self {
        let reason = "is a stream: it is read once, from its begin".to_owned();
        Self(Way::Refused(indices.into_iter(), [live.format.clone(), reason]))
    }
}

impl ReadAhead {
    /// The next scan; of a stream, it is waited for only until `is_stopped`, and then there is none.
    pub fn next_unless(&mut self, is_stopped: impl Fn() -> bool) -> Option<ReadScan> {
        match &mut self.0 {
            _ if is_stopped() => None,
            Way::Stream(pipe) => pipe.next_unless(is_stopped),
            _ => self.next(),
        }
    }
}

impl Iterator for ReadAhead {
    type Item = ReadScan;

    fn next(&mut self) -> Option<ReadScan> {
        match &mut self.0 {
            Way::Source(lanes) => lanes.next(),
            Way::Stream(pipe) => pipe.next(),
            Way::Refused(indices, [format, reason]) => indices.next().map(|index| ReadScan {
                index,
                sensor: 0,
                scan: Err(Error::dataset(&*format, &**reason)),
                imu: Vec::new(),
                read_secs: 0.0,
            }),
        }
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        match &self.0 {
            Way::Source(lanes) => {
                let left = lanes.indices.len() - lanes.next;
                (left, Some(left))
            }
            Way::Stream(_) => (0, None),
            Way::Refused(indices, _) => indices.size_hint(),
        }
    }
}

/// The threads that read from a source.
struct Lanes {
    source: Arc<dyn Source>,
    indices: Arc<[usize]>,
    next: usize,
    lanes: Vec<Lane>,
}

struct Lane {
    scans: Receiver<ReadScan>,
    thread: JoinHandle<()>,
}

impl Lanes {
    fn new(source: Arc<dyn Source>, indices: Vec<usize>) -> Self {
        let indices: Arc<[usize]> = indices.into();
        // Without threads (a system that refuses more of them) scans are read when they are asked for.
        let lanes: Option<Vec<_>> = (0..LANES.min(indices.len()))
            .map(|lane| Lane::spawn(lane, source.clone(), indices.clone()).ok())
            .collect();
        Self {
            source,
            indices,
            next: 0,
            lanes: lanes.unwrap_or_default(),
        }
    }

    fn next(&mut self) -> Option<ReadScan> {
        let index = *self.indices.get(self.next)?;
        let lane = self.lanes.get(self.next % LANES);
        self.next += 1;
        let Some(lane) = lane else {
            return Some(read(self.source.as_ref(), index));
        };
        Some(lane.scans.recv().unwrap_or_else(|_| {
            let scan = self.source.scans().get(index);
            ReadScan {
                index,
                sensor: scan.map_or(0, |s| s.sensor),
                scan: Err(died(scan.map_or("", |s| s.name.as_str()))),
                imu: Vec::new(),
                read_secs: 0.0,
            }
        }))
    }
}

impl std::fmt::Debug for Lanes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let left = self.indices.get(self.next..);
        f.debug_struct("Lanes").field("left", &left).finish_non_exhaustive()
    }
}

impl Lane {
    fn spawn(lane: usize, source: Arc<dyn Source>, indices: Arc<[usize]>) -> std::io::Result<Self> {
        let (sender, scans) = sync_channel(0);
        let thread = Builder::new().name(format!("read-{lane}")).spawn(move || {
            for &index in indices.iter().skip(lane).step_by(LANES) {
                if sender.send(read(source.as_ref(), index)).is_err() {
                    return; // nobody wants more
                }
            }
        })?;
        Ok(Self { scans, thread })
    }
}

fn read(source: &dyn Source, index: usize) -> ReadScan {
    let start = Instant::now();
    let scan = read_checked(source, index);
    ReadScan {
        index,
        sensor: source.scans().get(index).map_or(0, |s| s.sensor),
        scan,
        imu: Vec::new(),
        read_secs: start.elapsed().as_secs_f64(),
    }
}

fn died(name: &str) -> Error {
    Error::dataset(name, "the thread that was to read it has died")
}

impl Drop for Lanes {
    fn drop(&mut self) {
        for Lane { scans, thread } in self.lanes.drain(..) {
            drop(scans);
            // A lane that panicked has been reported by `next`.
            let _ = thread.join();
        }
    }
}

/// The thread that reads from a stream.
struct Pipe {
    /// What is kept of it may be read meanwhile.
    live: Arc<Live>,
    scans: Receiver<ReadScan>,
    /// `None` once its end is known.
    thread: Option<JoinHandle<()>>,
    next: usize,
}

impl std::fmt::Debug for Pipe {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pipe").field("next", &self.next).finish_non_exhaustive()
    }
}

impl Pipe {
    fn new(live: &Arc<Live>, mut stream: Box<dyn Stream>, selection: Selection) -> std::io::Result<Self> {
        let sensors = live.sensors.clone();
        // One waits in the channel, one to get into it.
        let (sender, scans) = sync_channel(1);
        let run = move || {
            for index in (0..).take_while(|&index| !selection.is_over(index)) {
                let start = Instant::now();
                let Some(StreamedScan { sensor, scan }) = stream.next() else {
                    return;
                };
                if !selection.contains(index) {
                    continue;
                }
                let scan = scan.and_then(|scan| {
                    let name = scan.name.clone();
                    checked(scan, &name, sensors.get(sensor))
                });
                let read = ReadScan {
                    index,
                    sensor,
                    scan,
                    imu: stream.imu(),
                    read_secs: start.elapsed().as_secs_f64(),
                };
                if sender.send(read).is_err() {
                    return; // nobody wants more
                }
            }
        };
        let thread = Builder::new().name("read-stream".to_owned()).spawn(run)?;
        Ok(Self {
            live: live.clone(),
            scans,
            thread: Some(thread),
            next: 0,
        })
    }

    fn next(&mut self) -> Option<ReadScan> {
        self.next_unless(|| false)
    }

    fn next_unless(&mut self, is_stopped: impl Fn() -> bool) -> Option<ReadScan> {
        loop {
            match self.scans.recv_timeout(LOOK_EVERY) {
                Ok(read) => {
                    self.next = read.index + 1;
                    return Some(read);
                }
                Err(RecvTimeoutError::Timeout) if is_stopped() => return None,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        // At the end, or the reader has panicked.
        let panicked = self.thread.take()?.join().is_err();
        panicked.then(|| ReadScan {
            index: self.next,
            sensor: 0,
            scan: Err(died(&self.live.format)),
            imu: Vec::new(),
            read_secs: 0.0,
        })
    }
}

/// All scans of a log in order, without invalid returns: what `for scan in &log` runs through. Reads ahead as [`ReadAhead`]
/// does.
#[derive(Debug)]
pub struct Scans {
    scans: ReadAhead,
    range: RangeLimits,
}

impl Scans {
    pub(crate) fn new(scans: ReadAhead, range: RangeLimits) -> Self {
        Self { scans, range }
    }
}

impl Iterator for Scans {
    type Item = Result<Scan>;

    fn next(&mut self) -> Option<Result<Scan>> {
        let mut scan = self.scans.next()?.scan;
        if let Ok(scan) = &mut scan {
            scan.drop_invalid(&self.range);
        }
        Some(scan)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.scans.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::ScanRef;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Twenty scans; counts the reads; scan 7 is broken, scan 9 panics.
    struct Counting {
        scans: Vec<ScanRef>,
        reads: Arc<AtomicUsize>,
    }

    fn number(index: usize) -> Result<Scan> {
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

    impl Source for Counting {
        fn format(&self) -> &str {
            "counting"
        }
        fn sensors(&self) -> &[Sensor] {
            &[]
        }
        fn scans(&self) -> &[ScanRef] {
            &self.scans
        }
        fn read(&self, index: usize) -> Result<Scan> {
            self.reads.fetch_add(1, Ordering::SeqCst);
            number(index)
        }
    }

    /// The same as a stream of so many scans, of two sensors that take turns.
    struct Flowing {
        next: usize,
        end: usize,
        reads: Arc<AtomicUsize>,
    }

    impl Stream for Flowing {
        fn format(&self) -> &str {
            "flowing"
        }
        fn sensors(&self) -> &[Sensor] {
            &[]
        }
        fn next(&mut self) -> Option<StreamedScan> {
            let index = self.next;
            self.next += 1;
            self.reads.fetch_add(1, Ordering::SeqCst);
            (index < self.end).then(|| StreamedScan {
                sensor: index % 2,
                scan: number(index),
            })
        }
    }

    fn source() -> (Arc<dyn Source>, Arc<AtomicUsize>) {
        let reads = Arc::new(AtomicUsize::new(0));
        let scan = |i: usize| ScanRef {
            name: format!("{i}.bin"),
            sensor: i % 2,
            time_ns: None,
            pose: None,
        };
        let source = Counting {
            scans: (0..20).map(scan).collect(),
            reads: reads.clone(),
        };
        (Arc::new(source), reads)
    }

    fn live(end: usize) -> (Arc<Live>, Arc<AtomicUsize>) {
        let reads = Arc::new(AtomicUsize::new(0));
        let stream = Flowing {
            next: 0,
            end,
            reads: reads.clone(),
        };
        (Arc::new(Live::new(stream)), reads)
    }

    /// Waits until the background has come to a rest; fails if it never reads that much.
    fn rests_at(reads: &AtomicUsize, count: usize) {
        while reads.load(Ordering::SeqCst) < count {
            std::thread::sleep(Duration::from_millis(1));
        }
        // It would read on at once.
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(reads.load(Ordering::SeqCst), count);
    }

    #[test]
    fn scans_come_in_order_and_a_broken_one_does_not_end_the_run() {
        let (live, _) = live(9);
        for scans in [
            ReadAhead::of_source(source().0, (0..9).collect()),
            ReadAhead::of_stream(&live, Selection::default()),
        ] {
            let read: Vec<_> = scans.collect();
            let numbers: Vec<_> = read.iter().map(|s| (s.index, s.sensor)).collect();
            assert_eq!(numbers, (0..9).map(|i| (i, i % 2)).collect::<Vec<_>>());
            for s in &read {
                match &s.scan {
                    Ok(scan) => assert_eq!(scan.name, s.index.to_string()),
                    Err(e) => assert_eq!((s.index, e.to_string().as_str()), (7, "7.bin: broken")),
                }
            }
            // It slept that long; how much longer it took is up to the machine.
            assert!(read[1].read_secs >= 0.003);
        }
    }

    #[test]
    fn no_more_than_two_scans_wait_and_dropping_stops_the_reading() {
        let (source, reads) = source();
        let mut scans = ReadAhead::of_source(source, (0..20).collect());
        assert_eq!(scans.size_hint(), (20, Some(20)));
        assert_eq!(scans.next().map(|s| s.index), Some(0));
        rests_at(&reads, 3);
        drop(scans);
        assert_eq!(reads.load(Ordering::SeqCst), 3);
    }

    #[test]
    fn a_stream_has_no_length_is_read_ahead_and_read_once() {
        let (live, reads) = live(usize::MAX);
        let selection = Selection {
            from: 2,
            step: 4,
            ..Default::default()
        };
        let mut scans = ReadAhead::of_stream(&live, selection);
        assert_eq!(scans.size_hint(), (0, None));
        assert_eq!(scans.next().map(|s| s.index), Some(2));
        // Scan 9 of the stream panics, between those that are selected.
        let read = scans.next().unwrap();
        assert_eq!((read.index, read.scan.is_ok()), (6, true));
        let died = scans.next().unwrap().scan.unwrap_err().to_string();
        assert_eq!(died, "flowing: the thread that was to read it has died");
        assert!(scans.next().is_none());
        assert_eq!(reads.load(Ordering::SeqCst), 10);
        let again: Vec<_> = ReadAhead::of_stream(&live, Selection::default()).collect();
        assert_eq!(again.len(), 1);
        let told = again[0].scan.as_ref().unwrap_err().to_string();
        assert_eq!(told, "flowing: is a stream: it is read once, from its begin");
    }

    #[test]
    fn no_more_than_two_scans_of_a_stream_wait() {
        let (live, reads) = live(usize::MAX);
        let mut scans = ReadAhead::of_stream(&live, Selection::default());
        assert_eq!(scans.next().map(|s| s.index), Some(0));
        rests_at(&reads, 3);
        drop(scans);
        rests_at(&reads, 3);
        // Not a scan more than selected is read.
        let (live, reads) = self::live(usize::MAX);
        let selection = "1..4:2".parse().unwrap();
        let numbers: Vec<_> = ReadAhead::of_stream(&live, selection).map(|s| s.index).collect();
        assert_eq!((numbers, reads.load(Ordering::SeqCst)), (vec![1, 3], 4));
    }

    #[test]
    fn a_reader_that_panics_is_reported_by_name() {
        let read: Vec<_> = ReadAhead::of_source(source().0, vec![8, 9, 10]).collect();
        assert!(read[0].scan.is_ok() && read[2].scan.is_ok());
        let message = read[1].scan.as_ref().unwrap_err().to_string();
        assert_eq!(message, "9.bin: the thread that was to read it has died");
    }
}
