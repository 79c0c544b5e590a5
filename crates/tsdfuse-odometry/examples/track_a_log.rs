//! Tracks a log and writes the pose at the begin of each scan: 12 numbers a line.

use std::io::Write;
use std::time::Instant;

use tsdfuse_odometry::{OdometryConfig, Quality, Tracker};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(log), Some(out)) = (args.next(), args.next()) else {
        return Err("usage: track_a_log LOG POSES.txt".into());
    };
    let log = tsdfuse_io::open(log)?;
    let mut tracker = Tracker::new(OdometryConfig::default());
    let mut file = std::io::BufWriter::new(std::fs::File::create(out)?);
    let mut spent = 0.0;
    let mut write = |tracker: &mut Tracker| -> std::io::Result<()> {
        while let Some(tracked) = tracker.pop() {
            let numbers = tracked
                .scan
                .pose
                .unwrap_or_default()
                .to_row_major_3x4()
                .map(|v| v.to_string());
            writeln!(file, "{}", numbers.join(" "))?;
            let Quality {
                covered,
                matched,
                rms_m,
                position_sigma_m,
                passes,
                ..
            } = tracked.quality;
            if std::env::var_os("V").is_some() {
                eprintln!(
                    "{} {covered:.3} {matched:.3} {rms_m:.4} {position_sigma_m:.5} {passes}",
                    tracked.scan.name
                );
            }
        }
        Ok(())
    };
    let mut scans = 0;
    for scan in &log {
        let scan = scan?;
        let start = Instant::now();
        tracker.push(scan);
        spent += start.elapsed().as_secs_f64();
        scans += 1;
        write(&mut tracker)?;
    }
    tracker.finish();
    write(&mut tracker)?;
    eprintln!(
        "{scans} scans, {:.1} a second, {} cells",
        f64::from(scans) / spent,
        tracker.cells()
    );
    Ok(())
}
