//! What the times of a cloud's points mean: their unit, and from when they count.
//!
//! Drivers differ, and messages do not say. It is inferred over several sweeps: times that lie near the stamp of their message are
//! absolute, in the unit in which they do. Others count from the stamp (its begin, or its end where they are negative), and
//! their unit is the one in which they span the time from sweep to sweep, or the larger part of it.

use tsdfuse::trajectory::secs_between;

/// A return this far from its message's stamp was not measured with it, seconds.
const MAX_OFFSET_SECS: f64 = 10.0;
/// Sweeps last this much longer than the time from one to the next, at most.
const MAX_SHARE: f64 = 1.6;
/// And at least this share of it, to be told from the same number in a unit 1000 times smaller.
const MIN_SHARE: f64 = 0.02;

/// Seconds of each unit.
const UNITS: [(f64, &str); 4] = [
    (1.0, "seconds"),
    (1e-3, "milliseconds"),
    (1e-6, "microseconds"),
    (1e-9, "nanoseconds"),
];

/// What was seen in one message: its stamp, and the first and the last of its points' times as they are in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sighting {
    pub(crate) stamp_ns: i64,
    pub(crate) first: f64,
    pub(crate) last: f64,
}

/// From when times count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reference {
    /// The stamp of the message.
    Stamp,
    /// The epoch of the stamps.
    Epoch,
    /// Something else: the earliest point of a message was measured at its stamp.
    Earliest,
}

/// What the times of points mean.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PointTimes {
    /// Seconds of one.
    pub(crate) unit: f64,
    pub(crate) reference: Reference,
    /// The conclusion with its reason, for people.
    pub(crate) why: String,
}

impl PointTimes {
    /// Infers the meaning; `period_secs` from one message to the next. Or says why the times are of no use.
    pub(crate) fn infer(sightings: &[Sighting], period_secs: f64) -> Result<Self, String> {
        let seen = || sightings.iter().filter(|s| s.first.is_finite() && s.last.is_finite());
        let mut spans: Vec<f64> = seen().map(|s| s.last - s.first).filter(|span| *span > 0.0).collect();
        spans.sort_by(f64::total_cmp);
        let Some(&span) = spans.get(spans.len() / 2) else {
            return Err("are all the same within a sweep".to_owned());
        };
        let absolute = UNITS.iter().find(|(unit, _)| {
            let near = |s: &Sighting| {
                let stamp = secs_between(0, s.stamp_ns);
                stamp > 1e6 && (s.first * unit - stamp).abs() < MAX_OFFSET_SECS
            };
            seen().all(near)
        });
        if let Some(&(unit, name)) = absolute {
            let mut from: Vec<f64> = seen().map(|s| s.first * unit - secs_between(0, s.stamp_ns)).collect();
            let from = median(&mut from);
            return Ok(Self {
                unit,
                reference: Reference::Epoch,
                why: format!(
                    "absolute {name}, from {from:.4} to {:.4} s after the stamp",
                    from + span * unit
                ),
            });
        }
        let share = |unit: f64| span * unit / period_secs;
        let fits = UNITS
            .iter()
            .find(|(unit, _)| (MIN_SHARE..MAX_SHARE).contains(&share(*unit)));
        let Some(&(unit, name)) = fits else {
            return Err(format!(
                "span {span} where sweeps are {period_secs:.4} s apart, which no unit explains"
            ));
        };
        let mut from: Vec<f64> = seen().map(|s| s.first * unit).collect();
        let from = median(&mut from);
        let secs = span * unit;
        let spans = format!("as they span {secs:.4} s where sweeps are {period_secs:.4} s apart");
        let (reference, why) = if from.abs() > MAX_OFFSET_SECS {
            let why = format!("{name} of another clock than the stamps', {spans}; the earliest is taken as the stamp");
            (Reference::Earliest, why)
        } else {
            let until = from + secs;
            let side = if until <= 0.25 * secs {
                "before the stamp, which is the end of the sweep"
            } else if from >= -0.25 * secs {
                "after the stamp, which is the begin of the sweep"
            } else {
                "around the stamp"
            };
            (
                Reference::Stamp,
                format!("{name} {side} ({from:.4} to {until:.4} s), {spans}"),
            )
        };
        Ok(Self { unit, reference, why })
    }

    /// Seconds after the stamp of each of a message's times; NaN where that is not possible. `base` says from when they count.
    pub(crate) fn secs(&self, raw: f64, base: f64) -> f32 {
        let secs = (raw - base) * self.unit;
        if secs.abs() <= MAX_OFFSET_SECS {
            secs as f32
        } else {
            f32::NAN
        }
    }

    /// What a time of zero seconds after the stamp is as it lies in the message; `earliest` is the smallest there.
    pub(crate) fn base(&self, stamp_ns: i64, earliest: f64) -> f64 {
        match self.reference {
            Reference::Stamp => 0.0,
            Reference::Epoch => stamp_ns as f64 * (1e-9 / self.unit),
            Reference::Earliest => earliest,
        }
    }
}

/// The middle one; NaN of none.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    const T0: i64 = 1_600_000_000_000_000_000;

    /// Ten sweeps at 10 Hz; `value` is the time of a point as a driver gives it, by the stamp and the seconds after it.
    fn inferred(from: f64, until: f64, value: impl Fn(f64, f64) -> f64) -> Result<PointTimes, String> {
        let sightings: Vec<_> = (0..10i64)
            .map(|k| {
                let stamp_ns = T0 + k * 100_000_000;
                let at = |secs| value(stamp_ns as f64 * 1e-9, secs);
                Sighting {
                    stamp_ns,
                    first: at(from),
                    last: at(until),
                }
            })
            .collect();
        PointTimes::infer(&sightings, 0.1)
    }

    #[test]
    fn drivers_are_understood() {
        type Value = fn(f64, f64) -> f64;
        let cases: [(&str, f64, f64, f64, Reference, Value); 8] = [
            ("Ouster t", 0.0, 0.0999, 1e-9, Reference::Stamp, |_, s| s * 1e9),
            ("Velodyne time", -0.0999, 0.0, 1.0, Reference::Stamp, |_, s| s),
            ("LIO-SAM time", 0.0, 0.0999, 1.0, Reference::Stamp, |_, s| s),
            ("Hesai timestamp", 0.0, 0.0999, 1.0, Reference::Epoch, |t, s| t + s),
            ("Livox timestamp", 0.0, 0.0999, 1e-9, Reference::Epoch, |t, s| {
                (t + s) * 1e9
            }),
            ("microseconds", 0.0, 0.0999, 1e-6, Reference::Stamp, |_, s| s * 1e6),
            ("milliseconds", -0.05, 0.05, 1e-3, Reference::Stamp, |_, s| s * 1e3),
            ("own clock", 0.0, 0.0999, 1e-9, Reference::Earliest, |t, s| {
                (t - 1.5e9 + s) * 1e9
            }),
        ];
        for (name, from, until, unit, reference, value) in cases {
            let times = inferred(from, until, value).unwrap();
            assert_eq!(
                (times.unit, times.reference),
                (unit, reference),
                "{name}: {}",
                times.why
            );
            let stamp = T0 as f64 * 1e-9;
            let raw = value(stamp, from + 0.01);
            let want = if reference == Reference::Earliest {
                0.01
            } else {
                from + 0.01
            };
            let got = times.secs(raw, times.base(T0, value(stamp, from)));
            assert!((f64::from(got) - want).abs() < 1e-5, "{name}: {got} {want}");
        }
        let why = |from, until| inferred(from, until, |_, s| s).unwrap().why;
        assert!(why(-0.1, 0.0).contains("end of the sweep"));
        assert!(why(0.0, 0.1).contains("begin of the sweep"));
        // A sensor that looks ahead only is not measuring for most of its turn.
        assert_eq!(inferred(0.04, 0.05, |_, s| s * 1e6).unwrap().unit, 1e-6);
    }

    #[test]
    fn times_of_no_use_are_told() {
        assert_eq!(
            inferred(0.0, 0.0, |_, s| s).unwrap_err(),
            "are all the same within a sweep"
        );
        let told = inferred(0.0, 0.1, |_, s| s * 1e4).unwrap_err();
        assert_eq!(
            told,
            "span 1000 where sweeps are 0.1000 s apart, which no unit explains"
        );
        let nan = PointTimes::infer(
            &[Sighting {
                stamp_ns: 0,
                first: f64::NAN,
                last: 1.0,
            }],
            0.1,
        );
        assert!(nan.is_err());
        assert!(inferred(0.0, 0.1, |_, s| s).unwrap().secs(1e9, 0.0).is_nan());
    }
}
