//! The returns of a sweep while it is put together.

use tsdfuse::Scan;
use tsdfuse::glam::Vec3;
use tsdfuse::scan::Dropped;

/// Columns of returns that grow packet by packet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Returns {
    points: Vec<Vec3>,
    rings: Vec<u16>,
    times_ns: Vec<i64>,
    intensities: Vec<f32>,
    /// Beams that did not come back.
    pub(crate) no_return: u64,
}

impl Returns {
    #[inline]
    pub(crate) fn push(&mut self, point: Vec3, ring: u16, time_ns: i64, intensity: f32) {
        self.points.push(point);
        self.rings.push(ring);
        self.times_ns.push(time_ns);
        self.intensities.push(intensity);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.points.is_empty() && self.no_return == 0
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// The scan, its times counted from `time_ns`; room for as many returns is kept for the next one.
    pub(crate) fn take(&mut self, time_ns: i64) -> Scan {
        let room = self.points.len();
        let Self {
            points,
            rings,
            times_ns,
            intensities,
            no_return,
        } = std::mem::take(self);
        self.points.reserve(room);
        self.rings.reserve(room);
        self.times_ns.reserve(room);
        self.intensities.reserve(room);
        let after = |t: i64| (t.saturating_sub(time_ns) as f64 * 1e-9) as f32;
        Scan {
            name: String::new(),
            time_ns: Some(time_ns),
            points,
            rings: Some(rings),
            times: Some(times_ns.into_iter().map(after).collect()),
            intensities: Some(intensities),
            dropped: Dropped {
                no_return,
                ..Dropped::default()
            },
            ..Scan::default()
        }
    }
}
