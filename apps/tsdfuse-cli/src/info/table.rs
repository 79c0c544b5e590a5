//! The table that `tsdfuse info` prints.

use std::fmt::Display;

use glam::DVec3;
use indicatif::HumanCount;
use tsdfuse::sensor::Pinhole;

use super::{Info, Points};
use crate::report::counted;

/// All that is known, a line each.
pub(super) fn of(info: &Info) -> String {
    let mut rows = Rows::default();
    let sample = &info.sample;
    rows.add("data set", format!("{} ({})", info.path.display(), info.format));
    match &info.camera {
        Some(camera) => rows.add("camera", camera_line(camera)),
        None => rows.add("sensor", sensor_line(info)),
    }
    rows.add("scans", scans_line(info));
    rows.add("path", format!("{:.1} m", info.path_length_m));
    let read = match sample.scans {
        n if n == info.scans => "all scans".to_owned(),
        n => format!("{n} of {} scans", info.scans),
    };
    let Points { min, mean, max } = &sample.points;
    let (min, max) = (HumanCount(*min), HumanCount(*max));
    let mean = HumanCount(mean.round() as u64);
    rows.add(
        "points",
        format!("{min} to {max} a scan, {mean} on average ({read} read)"),
    );
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
    info.notes.iter().for_each(|note| rows.add("note", note));
    let unreadable = sample.unreadable.iter();
    unreadable.for_each(|reason| rows.add("unreadable", reason));
    rows.finish()
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

fn sensor_line(info: &Info) -> String {
    let Some(sensor) = &info.sensor else {
        return "not known".to_owned();
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

fn scans_line(info: &Info) -> String {
    let secs = info.duration_secs.map(|secs| format!(" in {secs:.2} s"));
    let rate = info.rate_hz.map(|rate| format!(", {rate:.2} Hz"));
    let timed = secs.unwrap_or_else(|| ", without times".to_owned());
    format!("{}{timed}{}", info.scans, rate.unwrap_or_default())
}

pub(super) fn extent_line(low: DVec3, high: DVec3) -> String {
    let side = |axis: usize| format!("{:.1} to {:.1}", low[axis], high[axis]);
    let DVec3 { x, y, z } = high - low;
    let [from_x, from_y, from_z] = [side(0), side(1), side(2)];
    format!("{x:.1} x {y:.1} x {z:.1} m: x {from_x}, y {from_y}, z {from_z} m")
}

/// A table of two columns.
#[derive(Default)]
pub(super) struct Rows(String);

impl Rows {
    pub(super) fn add(&mut self, name: &str, value: impl Display) {
        self.0 += &format!("{name:<12}{value}\n");
    }

    pub(super) fn finish(self) -> String {
        self.0
    }
}
