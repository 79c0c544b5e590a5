//! Where one sweep ends and the next begins, for sensors that tell azimuths.

/// A turn, in hundredths of a degree.
pub(crate) const TURN: u16 = 36_000;
/// A step of the azimuth that is larger than this is a sector that the sensor does not look into; below it, packets were lost.
const GAP: u16 = 3_000;
/// Two gaps whose ends differ by less are the same sector.
const SAME: u16 = 300;
/// Steps that are smaller tell which way the sensor turns.
const SMALL: u16 = 500;
/// No sensor turns faster: within this time of a cut, the azimuth that trembles about it does not cut again.
const SHORTEST_NS: i64 = 10_000_000;
/// A sweep that takes longer is cut: the motor stands still.
const LONGEST_NS: i64 = 2_000_000_000;
/// Time without a packet, or backwards, after which a new sweep begins in any case.
const SILENCE_NS: i64 = 500_000_000;

/// Follows the azimuth, and tells which columns begin a sweep.
///
/// It does so where the azimuth passes 0, either way. Where a part of each turn is missing, because the sensor was told to look
/// into a sector only, it does so in that part instead: otherwise the two halves of a view ahead would be from different turns.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cutter {
    last: Option<(u16, i64)>,
    begin_ns: i64,
    /// The azimuth whose passing begins a sweep.
    cut: u16,
    /// The azimuth after the last gap, once there was one.
    gap: Option<u16>,
    backwards: bool,
    /// Whether the sweep now was begun where it should.
    is_regular: bool,
}

/// How a column begins a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cut {
    /// At the azimuth for it; whether the sweep before was begun there, too.
    Regular { whole: bool },
    /// Since time passed.
    Broken,
}

impl Cutter {
    /// Whether the next column, of this azimuth, is the first after the sector into which the sensor does not look.
    pub(crate) fn is_gap_before(&self, azimuth: u16, time_ns: i64) -> bool {
        let is_far = |before| turned(azimuth, before).min(turned(before, azimuth)) > GAP;
        self.last
            .is_some_and(|(before, before_ns)| is_far(before) && time_ns > before_ns)
            && self.gap.is_none_or(|gap| is_same(azimuth, gap))
    }

    /// Takes the azimuth of the next column (hundredths of a degree) and its time; whether a sweep begins with it.
    pub(crate) fn column(&mut self, azimuth: u16, time_ns: i64) -> Option<Cut> {
        let azimuth = azimuth % TURN;
        let Some((before, before_ns)) = self.last.replace((azimuth, time_ns)) else {
            self.begin_ns = time_ns;
            return None;
        };
        let silent_ns = time_ns.saturating_sub(before_ns);
        if (-SILENCE_NS..0).contains(&silent_ns) {
            // A packet that came late belongs to the sweep now, or shortly before it.
            self.last = Some((before, before_ns));
            return None;
        }
        if silent_ns.saturating_abs() > SILENCE_NS || time_ns.saturating_sub(self.begin_ns) > LONGEST_NS {
            self.begin_ns = time_ns;
            self.is_regular = false;
            return Some(Cut::Broken);
        }
        let forward = turned(azimuth, before);
        let backward = turned(before, azimuth);
        if forward != 0 && forward < SMALL {
            self.backwards = false;
        } else if backward != 0 && backward < SMALL {
            self.backwards = true;
        }
        let step = if self.backwards { backward } else { forward };
        // A small step the other way is the motor's tremble.
        let is_tremble = step > TURN - SMALL;
        let mut moved = false;
        let is_gap = step > GAP && !is_tremble;
        if is_gap && self.gap.replace(azimuth).is_none_or(|gap| is_same(azimuth, gap)) {
            // Somewhat before the end of the gap, which is not always at the same place.
            let cut = turned(azimuth, if self.backwards { TURN - SAME } else { SAME });
            moved = turned(cut, self.cut).min(turned(self.cut, cut)) > 2 * SAME;
            self.cut = if moved { cut } else { self.cut };
        }
        let (from, to) = (turned(before, self.cut), turned(azimuth, self.cut));
        let passes = match self.backwards {
            _ if is_tremble || step == 0 => false,
            false => to < from,
            true => to > from,
        };
        if !passes || time_ns.saturating_sub(self.begin_ns) < SHORTEST_NS {
            return None;
        }
        self.begin_ns = time_ns;
        let whole = std::mem::replace(&mut self.is_regular, true) && !moved;
        Some(Cut::Regular { whole })
    }
}

/// How far an azimuth is ahead of another one.
pub(crate) fn turned(azimuth: u16, from: u16) -> u16 {
    let turn = u32::from(TURN);
    ((u32::from(azimuth) + turn - u32::from(from) % turn) % turn) as u16
}

fn is_same(a: u16, b: u16) -> bool {
    turned(a, b).min(turned(b, a)) < SAME
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The columns that begin sweeps, of a sensor that turns ten times a second and sees what `sees` says.
    fn cuts(step: i32, first: i32, turns: f64, sees: impl Fn(u16) -> bool) -> Vec<(u16, Cut)> {
        let mut cutter = Cutter::default();
        let count = (f64::from(TURN) * turns / f64::from(step.abs())) as i32;
        let mut cuts = Vec::new();
        for i in 0..count {
            let azimuth = (first + i * step).rem_euclid(i32::from(TURN)) as u16;
            let time_ns = i64::from(i * step.abs()) * 100_000_000 / i64::from(TURN);
            if sees(azimuth)
                && let Some(cut) = cutter.column(azimuth, time_ns)
            {
                cuts.push((azimuth, cut));
            }
        }
        cuts
    }

    const WHOLE: Cut = Cut::Regular { whole: true };
    const PART: Cut = Cut::Regular { whole: false };

    #[test]
    fn a_full_turn_is_cut_at_zero_either_way() {
        assert_eq!(cuts(20, 9_000, 2.9, |_| true), [(0, PART), (0, WHOLE), (0, WHOLE)]);
        let back = cuts(-20, 9_010, 2.5, |_| true);
        assert_eq!(back, [(35_990, PART), (35_990, WHOLE), (35_990, WHOLE)]);
    }

    /// From 270° over 0° to 90°: never cut in the middle once the sector is known, however wide it is.
    #[test]
    fn a_sector_is_not_cut_in_the_middle() {
        for (from, to) in [(27_000, 9_000), (30_000, 6_000), (33_000, 20_000)] {
            let found = cuts(20, 20_010, 6.0, |a| a >= from || a <= to);
            let inner: Vec<_> = found.iter().skip(2).collect();
            assert!(inner.len() >= 3, "{found:?}");
            assert!(inner.iter().all(|(a, _)| a.abs_diff(from) <= 20), "{found:?}");
            assert!(inner.iter().skip(1).all(|(_, cut)| *cut == WHOLE), "{found:?}");
        }
    }

    #[test]
    fn a_trembling_or_standing_motor_makes_no_sweeps_of_nothing() {
        let mut cutter = Cutter::default();
        let trembling = (0..1000).filter(|i| {
            let azimuth = if i % 3 == 0 { 35_999 } else { (i % 3) as u16 };
            cutter.column(azimuth, i * 50_000).is_some()
        });
        assert!(trembling.count() <= 5);
        let mut cutter = Cutter::default();
        let standing: Vec<_> = (0..100).filter_map(|i| cutter.column(5, i * 100_000_000)).collect();
        assert_eq!(standing, [Cut::Broken; 4]);
    }

    #[test]
    fn after_a_silence_a_sweep_begins() {
        let mut cutter = Cutter::default();
        assert_eq!(cutter.column(100, 0), None);
        assert_eq!(cutter.column(200, 600_000_000), Some(Cut::Broken));
        assert_eq!(cutter.column(300, -600_000_000), Some(Cut::Broken));
        // Any numbers are bearable.
        for time_ns in [i64::MIN, i64::MAX, i64::MIN, 0] {
            cutter.column(u16::MAX, time_ns);
        }
    }
}
