//! How much memory reading a long recording takes.

use peak_alloc::PeakAlloc;
use tsdfuse::Scan;
use tsdfuse::glam::Vec3;
use tsdfuse_io::{Selection, Sensor, ros};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

const POINTS: usize = 100_000;
/// Coordinates, intensity, time and ring of each point.
const SWEEP: usize = POINTS * (12 + 4 + 4 + 2);
/// The writer closes a chunk when it holds 4 MiB: two sweeps.
const CHUNK: usize = 2 * SWEEP;

#[test]
fn reading_holds_three_sweeps_and_a_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    let mut writer = ros::Writer::create(&path, &[Sensor::new("lidar")]).unwrap();
    for sweep in 0..40 {
        let scan = Scan {
            time_ns: Some(1_600_000_000_000_000_000 + sweep * 100_000_000),
            points: vec![Vec3::new(5.0, sweep as f32, 1.0); POINTS],
            rings: Some(vec![3; POINTS]),
            times: Some((0..POINTS).map(|i| i as f32 * 1e-6).collect()),
            intensities: Some(vec![7.0; POINTS]),
            ..Scan::default()
        };
        writer.write_scan(0, &scan).unwrap();
    }
    writer.finish().unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() > 40 * SWEEP as u64);
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    // Opening looks at a few sweeps, one by one.
    let log = tsdfuse_io::open(&path).unwrap();
    let opening = MEMORY.peak_usage() - before;
    MEMORY.reset_peak_usage();
    let points = log
        .read_ahead(&Selection::default())
        .map(|read| read.scan.unwrap().points.len());
    assert_eq!(points.sum::<usize>(), 40 * POINTS);
    let reading = MEMORY.peak_usage() - before;
    println!("opening {opening} bytes, reading {reading}, a sweep {SWEEP}");
    assert!(opening < 3 * SWEEP + CHUNK, "{opening} bytes");
    assert!(SWEEP < reading && reading < 3 * SWEEP + CHUNK, "{reading} bytes");
}
