//! A run that is watched in a browser.

use std::time::{Duration, Instant};

use tsdfuse::Scan;
use tsdfuse::glam::DVec3;
use tsdfuse_view::live::Live;

use crate::event::{Event, Observer};
use crate::report::{Sums, with_commas};

/// The share of the time that may be spent on telling what changed.
const SHARE: f64 = 0.02;

/// Returns of the last scan that are shown, about.
const RETURNS: usize = 20_000;

/// From sweep to sweep, and from figures to figures.
const PAUSE: Duration = Duration::from_millis(100);

/// Shows a run in a [`Live`] view, as its observer: the surface as it grows, the path, the last sweep, figures. Without viewers it
/// takes no time.
#[derive(Debug)]
pub struct LiveRun {
    live: Live,
    begun: Instant,
    voxel_size_m: f64,
    has_begun: bool,
    place: Option<DVec3>,
    shown: Option<Instant>,
    told: Option<Instant>,
    scans: usize,
    asked: Option<usize>,
    skipped: usize,
    sums: Sums,
    blocks: usize,
}

impl LiveRun {
    /// Shows a run in a view that shows nothing yet.
    pub fn new(live: Live) -> Self {
        Self {
            live,
            begun: Instant::now(),
            voxel_size_m: 0.0,
            has_begun: false,
            place: None,
            shown: None,
            told: None,
            scans: 0,
            asked: None,
            skipped: 0,
            sums: Sums::default(),
            blocks: 0,
        }
    }

    fn sweep(&mut self, scan: &Scan) {
        self.place = scan.pose.map(|pose| pose.translation);
        let Some(pose) = scan.pose else { return };
        if self.live.viewers() == 0 || self.shown.is_some_and(|at| at.elapsed() < PAUSE) {
            return;
        }
        self.shown = Some(Instant::now());
        let step = scan.points.len() / RETURNS + 1;
        let points = scan.points.iter().step_by(step);
        self.live
            .sweep(points.map(|point| pose.transform_point(point.as_dvec3())));
    }

    fn figures(&self) {
        let of = self
            .asked
            .map_or(String::new(), |asked| format!(" of {}", with_commas(asked as u64)));
        let seconds = self.begun.elapsed().as_secs_f64();
        let mut figures = vec![
            ("scans".to_owned(), format!("{}{of}", with_commas(self.scans as u64))),
            (
                "scans a second".to_owned(),
                format!("{:.1}", self.scans as f64 / seconds),
            ),
            ("points fused".to_owned(), with_commas(self.sums.fused)),
            ("blocks of the last scan".to_owned(), with_commas(self.blocks as u64)),
        ];
        if self.skipped > 0 {
            figures.push(("scans skipped".to_owned(), with_commas(self.skipped as u64)));
        }
        if let Some(bytes) = crate::machine::memory_bytes() {
            figures.push(("memory".to_owned(), format!("{} MiB", with_commas(bytes >> 20))));
        }
        self.live.figures(figures);
    }
}

impl Observer for LiveRun {
    fn on(&mut self, event: Event<'_>) {
        match event {
            Event::Begun {
                scans,
                done,
                voxel_size_m,
                ..
            } => {
                self.voxel_size_m = voxel_size_m;
                // A stream that is over is fused again.
                self.live.path(&[]);
                (self.scans, self.skipped, self.sums) = (0, 0, Sums::default());
                (self.begun, self.asked) = (Instant::now(), scans.map(|scans| scans.saturating_sub(done)));
            }
            Event::ScanRead { scan, .. } => self.sweep(scan),
            Event::ScanFused { report, blocks, .. } => {
                self.scans += 1;
                self.sums += &report.sums;
                self.blocks = blocks.len();
                self.live.scan(self.place, report.sums.prepare + report.sums.fuse);
                if self.told.is_none_or(|at| at.elapsed() >= PAUSE) {
                    self.told = Some(Instant::now());
                    self.figures();
                }
            }
            Event::ScanSkipped { .. } => self.skipped += 1,
            Event::SurfaceChanged(changes) => {
                if !std::mem::replace(&mut self.has_begun, true) {
                    self.live.begin(self.place.unwrap_or_default(), self.voxel_size_m);
                }
                self.live.changes(changes);
            }
            Event::LoopsClosed(ends) => self.live.loops(ends),
            Event::Done { .. } => {
                self.figures();
                self.live.end();
            }
            _ => {}
        }
    }

    fn surface_share(&self) -> Option<f64> {
        Some(if self.live.viewers() > 0 { SHARE } else { 0.0 })
    }
}
