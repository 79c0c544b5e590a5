//! What `tsdfuse info` tells of a log.

use indicatif::HumanCount;
use tsdfuse::sensor::Pinhole;
use tsdfuse_io::{Recorded, Topic};
use tsdfuse_run::log_info::{LogInfo, Points};
use tsdfuse_run::report::counted;

use super::rows::{Rows, extent_line};

/// All that is known, a line each.
pub(super) fn table(info: &LogInfo) -> String {
    let mut rows = Rows::default();
    let sample = &info.sample;
    rows.add("log", format!("{} ({})", info.path.display(), info.format));
    match &info.camera {
        Some(camera) => rows.add("camera", camera_line(camera)),
        None if info.scans > 0 => rows.add("sensor", sensor_line(info)),
        None => {}
    }
    let correction = &info.correction;
    if correction.elevation_deg != 0.0 {
        rows.add(
            "elevations",
            format!(
                "each point is turned up by {}°, a known error of this sensor; --set sensor.elevation_correction_deg=0 leaves it",
                correction.elevation_deg
            ),
        );
    }
    if correction.range_m != 0.0 {
        rows.add("ranges", format!("{} m are added to each", correction.range_m));
    }
    if !correction.beams.is_empty() {
        rows.add("beams", format!("{} are corrected one by one", correction.beams.len()));
    }
    rows.add("scans", scans_line(info));
    if info.placed_scans > 0 {
        rows.add("path", format!("{:.1} m", info.path_length_m));
    }
    if sample.scans > 0 {
        sample_rows(info, &mut rows);
    }
    if info.sensors.len() > 1 {
        rows.add("sensors", info.sensors.join(", "));
    }
    if info.scans > 0 && info.placed_scans == 0 {
        rows.add(
            "poses",
            "none: fuse finds them by odometry, or --poses FILE supplies them",
        );
    }
    if let Some(poses) = info.trajectory_poses {
        rows.add("trajectory", format!("{} poses", HumanCount(poses as u64)));
    }
    for (name, count) in [
        ("IMU samples", info.imu_samples),
        ("images", info.images),
        ("GNSS fixes", info.gnss_fixes),
    ] {
        if count > 0 {
            rows.add(name, HumanCount(count as u64));
        }
    }
    if let Some(Recorded { topics, conclusions }) = &info.recorded {
        topics.iter().for_each(|topic| rows.add("topic", topic_line(topic)));
        for (subject, text) in conclusions {
            rows.add(subject, text);
        }
    }
    info.notes.iter().for_each(|note| rows.add("note", note));
    let unreadable = sample.unreadable.iter();
    unreadable.for_each(|reason| rows.add("unreadable", reason));
    rows.finish()
}

/// What is in the scans that were read.
fn sample_rows(info: &LogInfo, rows: &mut Rows) {
    let sample = &info.sample;
    let read = match sample.scans {
        n if n == info.scans => "all scans".to_owned(),
        n => format!("{n} of {} scans", info.scans),
    };
    let Points { min, mean, max } = &sample.points;
    let counts = if min == max {
        format!("{} a scan", HumanCount(*min))
    } else {
        let (min, max, mean) = (HumanCount(*min), HumanCount(*max), HumanCount(mean.round() as u64));
        format!("{min} to {max} a scan, {mean} on average")
    };
    rows.add("points", format!("{counts} ({read} read)"));
    rows.add(
        "left out",
        match counted(&sample.invalid) {
            none if none.is_empty() => "none".to_owned(),
            invalid => invalid.join(", "),
        },
    );
    if let Some([near, far]) = sample.range_m {
        rows.add("ranges", format!("{near:.2} to {far:.2} m"));
    }
    if let Some([low, high]) = sample.extent_m {
        rows.add("extent", extent_line(low, high));
    }
    let columns = [
        ("rings", sample.with_rings),
        ("times", sample.with_times),
        ("motion", sample.with_motion),
        ("intensities", sample.with_intensities),
    ];
    // Pixels have no such columns.
    for (name, scans) in columns.into_iter().filter(|_| info.camera.is_none()) {
        let which = match scans {
            0 => "no".to_owned(),
            n if n == sample.scans => "yes".to_owned(),
            n => format!("in {n} of {} scans", sample.scans),
        };
        rows.add(name, which);
    }
}

fn camera_line(camera: &Pinhole) -> String {
    let Pinhole {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    } = *camera;
    let across = (camera.ray(-0.5, cy).y.atan() - camera.ray(width as f32 - 0.5, cy).y.atan()).to_degrees();
    let down = (camera.ray(cx, -0.5).z.atan() - camera.ray(cx, height as f32 - 0.5).z.atan()).to_degrees();
    format!("{width} x {height} pixels, {across:.1}° x {down:.1}°, fx {fx} fy {fy} cx {cx} cy {cy}")
}

fn sensor_line(info: &LogInfo) -> String {
    let Some(sensor) = &info.sensor else {
        return "not known: --sensor NAME, or a FILE.toml, tells its beams".to_owned();
    };
    let low = sensor.elevations_deg.first().copied().unwrap_or_default();
    let high = sensor.elevations_deg.last().copied().unwrap_or_default();
    format!(
        "{}{}: {} beams from {low:.1}° to {high:.1}°, {} columns, {} m to {} m",
        sensor.name,
        if info.sensor_guessed { ", guessed" } else { "" },
        sensor.rings(),
        sensor.columns,
        sensor.min_range_m,
        sensor.max_range_m
    )
}

fn topic_line(topic: &Topic) -> String {
    let Topic {
        name, kind, messages, ..
    } = topic;
    let plural = if *messages == 1 { "" } else { "s" };
    let mut line = format!("{name} ({kind}), {} message{plural}", HumanCount(*messages as u64));
    if let Some(rate) = topic.rate_hz {
        line += &format!(", {rate:.1} Hz");
        if let Some(gap) = topic.longest_gap_secs.filter(|gap| gap * rate > 2.5) {
            line += &format!(", a gap of {gap:.2} s");
        }
    }
    if let Some(delay) = topic.delay_secs.filter(|delay| delay.abs() > 1.0) {
        line += &format!(", its clock is {delay:.3} s behind the recorder's");
    }
    line + if topic.is_read { ", read" } else { "" }
}

fn scans_line(info: &LogInfo) -> String {
    if info.scans < 2 {
        return info.scans.to_string();
    }
    let secs = info.duration_secs.map(|secs| format!(" in {secs:.2} s"));
    let rate = info.rate_hz.map(|rate| format!(", {rate:.2} Hz"));
    let timed = secs.unwrap_or_else(|| ", without times".to_owned());
    format!("{}{timed}{}", info.scans, rate.unwrap_or_default())
}
