//! What a search for settings found.

use serde::Serialize;
use tsdfuse_eval::held_out::HeldOut;
use tsdfuse_run::report::SkippedScan;

/// Candidates that are shown.
const SHOWN: usize = 10;

/// What the search found.
#[derive(Clone, Debug, Serialize)]
pub struct Tuned {
    /// Scans of the last round that was completed.
    pub scans: usize,
    /// Scans that were asked for.
    pub all_scans: usize,
    /// One of so many was held out.
    pub hold_out: usize,
    /// Candidates there were.
    pub candidates: usize,
    /// Those that were tried.
    pub tried: usize,
    /// Whether time was up before one candidate was left or all scans were used.
    pub out_of_time: bool,
    /// How long it took, seconds.
    pub secs: f64,
    /// The candidates of that round, the best first.
    pub ranking: Vec<Score>,
    /// Scans that could not be used, each once.
    pub skipped_scans: Vec<SkippedScan>,
}

/// How good a candidate was.
#[derive(Clone, Debug, Serialize)]
pub struct Score {
    /// The form's name.
    pub name: String,
    /// Its voxels, metres.
    pub voxel_size_m: f64,
    /// Its truncation, metres.
    pub truncation_m: f64,
    /// Fusing, wall time on all cores.
    pub secs_per_scan: f64,
    /// How well it predicted the held-out scans.
    pub held_out: HeldOut,
    /// The command that makes a mesh with it.
    pub command: String,
}

impl Tuned {
    /// The best candidates, and the command of the best one.
    pub fn text(&self) -> String {
        let Some(best) = self.ranking.first() else {
            return String::new();
        };
        let mut text = format!(
            "{} of {} candidates tried in {:.0} s; the best on {} of {} scans, one of {} held out{}.\n\
             Objective: capped, the mean over all held-out returns of min(|Δr|, {} m), where false and missing surface\n\
             count as the most.\n\n",
            self.tried,
            self.candidates,
            self.secs,
            self.scans,
            self.all_scans,
            self.hold_out,
            if self.out_of_time { "; time was up" } else { "" },
            best.held_out.margin_m,
        );
        text += &format!(
            "  {:<22}{:>8}{:>8}{:>11}{:>8}{:>8}{:>9}{:>11}{:>9}\n",
            "", "voxel m", "trunc m", "capped mm", "hits", "false", "missing", "median mm", "scans/s"
        );
        for score in self.ranking.iter().take(SHOWN) {
            let held_out = &score.held_out;
            text += &format!(
                "  {:<22}{:>8}{:>8}{:>11.1}{:>8.3}{:>8.3}{:>9.3}{:>11.1}{:>9.1}\n",
                score.name,
                score.voxel_size_m,
                score.truncation_m,
                1e3 * held_out.capped_error_m,
                held_out.hit_rate,
                held_out.false_surface,
                held_out.missing,
                1e3 * held_out.error.map_or(f64::NAN, |error| error.median_m),
                1.0 / score.secs_per_scan,
            );
        }
        text + &format!("\n{}\n", best.command)
    }
}
