//! What people see of a run: bars on a terminal, notes, and a few lines in the end.

use indicatif::{BinaryBytes, HumanCount, ProgressBar};
use tsdfuse::glam::DVec3;
use tsdfuse_run::LoopsReport;
use tsdfuse_run::report::{
    ColorReport, FinishReport, MapReport, MeshReport, OdometryReport, Report, SavedMap, TilesReport, Totals, ViewReport,
};
use tsdfuse_run::{Event, Observer};

use crate::progress::{self, note, say};

/// Shows a run.
#[derive(Default)]
pub(crate) struct Terminal {
    bar: Option<ProgressBar>,
    is_resumed: bool,
    /// Where the sensor was last, and how far it has moved, metres.
    here: Option<DVec3>,
    driven_m: f64,
}

impl Terminal {
    /// Of a run that goes on.
    pub(crate) fn resumed() -> Self {
        Self {
            is_resumed: true,
            ..Self::default()
        }
    }

    /// Writes a line above the bar.
    fn line(&self, line: std::fmt::Arguments<'_>) {
        match &self.bar {
            Some(bar) => bar.suspend(|| say(line)),
            None => say(line),
        }
    }
}

impl Observer for Terminal {
    fn on(&mut self, event: Event<'_>) {
        match event {
            Event::Begun { scans, done, .. } => {
                if std::mem::take(&mut self.is_resumed) {
                    let asked = scans.map_or("the".to_owned(), |scans| scans.to_string());
                    say(format_args!("continuing after {done} of {asked} scans"));
                }
                (self.here, self.driven_m) = (None, 0.0);
                self.bar = Some(progress::scans("fusing", scans.map(|scans| scans.saturating_sub(done))));
            }
            Event::ScanRead { scan, .. } => {
                let here = scan.pose.map(|pose| pose.translation);
                self.driven_m += here.zip(self.here).map_or(0.0, |(here, last)| here.distance(last));
                self.here = here.or(self.here);
            }
            Event::ScanFused { report, .. } => {
                if let (Some(bar), Some(quality)) = (&self.bar, &report.odometry) {
                    let matched = 100.0 * quality.matched;
                    bar.set_message(format!("fusing, {:.0} m driven, {matched:.0} % matched", self.driven_m));
                }
                self.bar.iter().for_each(|bar| bar.inc(1));
            }
            Event::ScanSkipped { skipped, .. } => {
                self.bar.iter().for_each(|bar| bar.inc(1));
                let (name, reason) = (&skipped.name, &skipped.reason);
                self.line(format_args!("tsdfuse: warning: skipped {name}: {reason}"));
            }
            Event::MapStored { path, done, asked } => {
                let asked = asked.map_or(String::new(), |asked| format!(" of {asked}"));
                self.line(format_args!("  stored   {done}{asked} scans in {}", path.display()));
            }
            Event::OverLimit { bytes } => self.line(format_args!(
                "tsdfuse: note: --memory: what a scan can touch takes more, {}",
                BinaryBytes(bytes as u64)
            )),
            Event::Working(doing) => self.bar = Some(progress::working(doing.to_owned())),
            Event::Note(sentence) => self.line(format_args!("tsdfuse: note: {sentence}")),
            Event::Done { stopped } => {
                self.bar = None;
                if stopped {
                    note("stopped: the result holds the scans so far");
                }
            }
            _ => {}
        }
    }
}

/// What odometry did, and where its poses are not to be trusted.
fn odometry(report: &OdometryReport, scans: usize) {
    say(format_args!(
        "  poses    by odometry over {:.1} m, in {:.2} s",
        report.distance_m, report.seconds
    ));
    loops(report);
    doubts(report, scans);
}

/// Which places were seen before.
pub(crate) fn loops(report: &OdometryReport) {
    let Some(LoopsReport {
        closures,
        distrusted,
        anchoring,
        ..
    }) = &report.loops
    else {
        return;
    };
    if let (Some(first), Some(last)) = (closures.first(), closures.last()) {
        let off = closures.iter().map(|closure| closure.off_m).fold(0.0, f64::max);
        say(format_args!(
            "  loops    {} closures, from scan {} at scan {} to scan {} at scan {}; up to {off:.3} m were corrected at once",
            closures.len(),
            first.earlier,
            first.later,
            last.earlier,
            last.later
        ));
    }
    if let Some(found) = anchoring {
        let (off, first) = (found.fixes_after_m, found.fixes_before_m);
        if found.fixes > 0 {
            let (fixes, doubted) = (found.fixes, found.doubted_fixes);
            say(format_args!(
                "  GNSS     {fixes} fixes, {doubted} doubted; off by {off:.3} m in the median, by {first:.3} m before"
            ));
        }
        if found.levels > 0 {
            let (off, first) = (found.tilt_after_rad.to_degrees(), found.tilt_before_rad.to_degrees());
            say(format_args!(
                "  gravity  at {} places; off by {off:.2}° in the median, by {first:.2}° before",
                found.levels
            ));
        }
    }
    let doubted = closures.iter().filter(|closure| closure.is_doubted).count();
    if doubted > 0 {
        say(format_args!(
            "  note: {doubted} closures disagree with the rest, and hardly count"
        ));
    }
    if *distrusted > 0 {
        say(format_args!(
            "  note: {distrusted} places look like an earlier one that is too far away by odometry: not taken for the same"
        ));
    }
}

/// Where poses of odometry are not to be trusted.
pub(crate) fn doubts(report: &OdometryReport, scans: usize) {
    let OdometryReport {
        undetermined,
        unmatched,
        pieces,
        imu,
        correction,
        mounting,
        ..
    } = report;
    if *pieces > 1 {
        say(format_args!(
            "  note: the sensor was lost, and its way back was not found: the trajectory has {pieces} pieces, each of which begins where the motion before led"
        ));
    }
    for note in imu.iter().flat_map(|imu| &imu.notes) {
        say(format_args!("  note: {note}"));
    }
    if let Some(correction) = correction {
        let beams = match correction.beams.len() {
            0 => String::new(),
            n => format!(", and each of {n} beams on its own"),
        };
        say(format_args!(
            "  note: the sensor is off: elevations are corrected by {:.3}°, ranges by {:.3} m{beams}; --save-sensor keeps that for other runs",
            correction.elevation_deg, correction.range_m
        ));
    }
    if let Some(mounting) = mounting {
        let (shift, turn) = (mounting.shift_m, mounting.turn_deg);
        say(format_args!(
            "  note: seen from where the given poses put it, the sensor is shifted by {:.3}, {:.3}, {:.3} m and turned by {:.2}, {:.2}, {:.2}° (about x, y, z), and their clock is {:+.3} s ahead; --save-sensor keeps that for other runs",
            shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, mounting.time_offset_s
        ));
    }
    if *undetermined > 0 {
        say(format_args!(
            "  note: the returns of {undetermined} of {scans} scans do not tell the position along some direction (a tunnel, a plain); there the motion before goes on"
        ));
    }
    if *unmatched > 0 {
        say(format_args!(
            "  note: most returns of {unmatched} of {scans} scans do not lie on what was seen before: the trajectory may be broken there"
        ));
    }
}

/// The few lines for people about a run.
pub(crate) fn summarize(report: &Report) {
    let Totals {
        scans,
        sums,
        finish,
        seconds,
    } = &report.totals;
    let on = report
        .device
        .as_ref()
        .map_or(String::new(), |device| format!(" on {device}"));
    // After a resume, only the scans of this process took this time.
    let (fused_here, earlier) = (report.scans.len(), scans - report.scans.len());
    let rate = fused_here as f64 / seconds;
    if earlier == 0 {
        say(format_args!(
            "{scans} scans fused in {seconds:.2} s, {rate:.1} scans/s{on}"
        ));
    } else if fused_here == 0 {
        say(format_args!("all {scans} scans were fused before{on}"));
    } else {
        say(format_args!(
            "{scans} scans fused, {fused_here} of them now in {seconds:.2} s, {rate:.1} scans/s{on}"
        ));
    }
    let (points, fused) = (HumanCount(sums.points), HumanCount(sums.fused));
    say(format_args!("  points   {fused} of {points} fused{}", sums.left_out()));
    if let Some(odometry) = &report.odometry {
        self::odometry(odometry, *scans);
    }
    map(&report.map, report.peak_memory_bytes);
    let (saved, mesh) = (report.saved_map.as_ref(), report.mesh.as_ref());
    mesh.inspect(|report| self::mesh(report));
    say(format_args!(
        "  seconds  read {:.2} (in the background), prepare {:.2}, fuse {:.2}{}{}{}{}; total {:.2}",
        sums.read,
        sums.prepare,
        sums.fuse,
        match finish {
            FinishReport { updated_blocks: 0, .. } => String::new(),
            FinishReport { seconds, .. } => format!(", finish {seconds:.2}"),
        },
        saved.map_or(String::new(), |map| format!(", save map {:.2}", map.seconds)),
        report.growth.as_ref().map_or(String::new(), |growth| format!(
            ", {} meshes on the way {:.2}",
            growth.meshes, growth.seconds
        )),
        mesh.map_or(String::new(), |mesh| format!(
            ", mesh {:.2}, write {:.2}",
            mesh.seconds, mesh.write_seconds
        )),
        report.wall_seconds
    ));
    saved.inspect(|map| saved_map(map));
    mesh.inspect(|mesh| mesh_file(mesh));
    report.preview.as_ref().inspect(|view| pictures(view));
}

/// A line about a map.
pub(crate) fn map(report: &MapReport, peak_memory_bytes: Option<u64>) {
    say(format_args!(
        "  map      {} blocks, {} voxels observed, {}{}",
        HumanCount(report.blocks as u64),
        HumanCount(report.observed_voxels as u64),
        BinaryBytes(report.bytes as u64),
        peak_memory_bytes.map_or(String::new(), |bytes| format!("; peak memory {}", BinaryBytes(bytes)))
    ));
}

/// A line about a saved map.
pub(crate) fn saved_map(SavedMap { path, bytes, .. }: &SavedMap) {
    say(format_args!("  wrote    {}, {}", path.display(), BinaryBytes(*bytes)));
}

/// A line or two about a surface.
pub(crate) fn mesh(report: &MeshReport) {
    let count = |n: usize| HumanCount(n as u64);
    let (vertices, triangles) = (count(report.vertices), count(report.triangles));
    say(format_args!("  mesh     {triangles} triangles, {vertices} vertices"));
    if let Some(ColorReport { images, vertices }) = report.color {
        let percent = 100.0 * vertices as f64 / report.vertices.max(1) as f64;
        say(format_args!(
            "  colours  of {} images, for {percent:.0}% of the vertices",
            count(images)
        ));
    }
    if let Some(TilesReport { tiles, levels, bytes }) = report.tiles {
        let (tiles, bytes) = (count(tiles), BinaryBytes(bytes));
        say(format_args!("  tiles    {tiles} in {levels} levels, {bytes}"));
    }
}

/// A line that says where a mesh lies, if it is a file.
pub(crate) fn mesh_file(report: &MeshReport) {
    if report.path.as_os_str() != "-" {
        say(format_args!("  wrote    {}", report.path.display()));
    }
}

/// A line for each picture.
pub(crate) fn pictures(view: &ViewReport) {
    view.files
        .iter()
        .for_each(|file| say(format_args!("  wrote    {}", file.display())));
}
