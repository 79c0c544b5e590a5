//! How well a map predicts scans that it does not hold.

use tsdfuse::VoxelMap;
use tsdfuse::render::{RenderConfig, Renderer};
use tsdfuse_eval::held_out::Collector;
use tsdfuse_io::{Log, Selection};
use tsdfuse_run::RunConfig;
use tsdfuse_run::report::SkippedScan;

use crate::error::{Error, Result};

/// Which scans are held out, and how far surface may be from their returns.
#[derive(Clone, Debug)]
pub(crate) struct HeldOutScans {
    /// Their numbers in the log.
    pub(crate) indices: Vec<usize>,
    /// Largest distance between a held-out return and its surface, metres, metres.
    pub(crate) margin_m: f64,
    /// Whether scans that cannot be used are left out.
    pub(crate) skip_bad: bool,
}

impl HeldOutScans {
    /// Those of a selection of a log with so many scans.
    pub(crate) fn of(selection: &Selection, scans: usize, margin_m: f64, skip_bad: bool) -> Self {
        Self {
            indices: selection.held_out_indices(scans),
            margin_m,
            skip_bad,
        }
    }

    /// Looks at a map along the rays of the held-out scans; also names those that could not be used.
    pub(crate) fn measure(
        &self,
        log: &Log,
        map: &VoxelMap,
        config: &RunConfig,
    ) -> Result<(Collector, Vec<SkippedScan>)> {
        let look = RenderConfig {
            min_weight: config.mesh.min_weight,
            ..Default::default()
        };
        let renderer = Renderer::new(map, &look)?;
        let mut collector = Collector::new(self.margin_m);
        let mut skipped = Vec::new();
        for read in log.read_indices(self.indices.clone()) {
            let added = read.scan.map_err(Error::from).and_then(|mut scan| {
                scan.drop_invalid(&config.range);
                collector.add(&renderer, &scan).map_err(Error::failed)
            });
            match added {
                Err(error) if self.skip_bad => {
                    skipped.push(SkippedScan {
                        name: log.scans()[read.index].name.clone(),
                        reason: error.to_string(),
                    });
                }
                other => other?,
            }
        }
        if collector.result().is_none() {
            return Err(Error::failed("the held-out scans have no valid return"));
        }
        Ok((collector, skipped))
    }
}

/// The selection with the default of held-out scans where nothing is asked for: one of each `every`, or of as many as there
/// are. 0 holds out none.
pub(crate) fn selection(asked: &Selection, hold_out: Option<usize>, every: usize, scans: usize) -> Result<Selection> {
    let all = Selection {
        hold_out: None,
        ..asked.clone()
    };
    let count = all.indices(scans).len();
    let hold_out = match hold_out {
        Some(0) => return Ok(all),
        Some(1) => {
            return Err(Error::config(
                "--hold-out 1 would hold out every scan; expected 2 or more, or 0 for none",
            ));
        }
        Some(every) => every,
        None if count < 2 => {
            return Err(Error::config(
                "one scan is too few to hold one out; --hold-out 0 holds out none",
            ));
        }
        None => every.min(count),
    };
    let selection = Selection {
        hold_out: Some(hold_out),
        ..all
    };
    let fused = selection.indices(scans).len();
    if fused == 0 || fused == count {
        return Err(Error::config(format_args!(
            "--hold-out {hold_out}: {count} scans are too few to hold out the middle one of each {hold_out}"
        )));
    }
    Ok(selection)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scan_is_fused_or_held_out() {
        let asked = Selection {
            from: 10,
            to: Some(35),
            ..Selection::default()
        };
        let all: Vec<usize> = (10..35).collect();
        assert_eq!(selection(&asked, Some(0), 10, 100).unwrap().indices(100), all);
        let held = selection(&asked, None, 10, 100).unwrap();
        let mut both = held.indices(100);
        assert_eq!(held.held_out_indices(100), [15, 25]);
        both.extend(held.held_out_indices(100));
        both.sort_unstable();
        assert_eq!(both, all);
        // Where there are fewer scans, more of them are held out.
        let few = selection(&asked, None, 10, 14).unwrap();
        assert_eq!((few.hold_out, few.held_out_indices(14)), (Some(4), vec![12]));
        for (hold_out, scans, told) in [
            (Some(1), 100, "would hold out every scan"),
            (
                Some(30),
                13,
                "3 scans are too few to hold out the middle one of each 30",
            ),
            (None, 11, "one scan is too few to hold one out"),
        ] {
            let error = selection(&asked, hold_out, 10, scans).unwrap_err().to_string();
            assert!(error.contains(told), "{error}");
        }
    }
}
