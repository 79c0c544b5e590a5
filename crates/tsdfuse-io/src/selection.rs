//! Which scans of a log are read.

use std::fmt::{self, Display};
use std::str::FromStr;

/// Every `step`-th scan of `from..to`, without the middle one of each `hold_out` of these. Works without knowing how many
/// scans there are. The default selects all.
///
/// Written and parsed as `FROM..TO:STEP`; `FROM`, `TO` and `:STEP` may be left out. (The held-out scans are no part of the text.)
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// The first scan.
    pub from: usize,
    /// The scan after the last one; `None`: to the end.
    pub to: Option<usize>,
    /// 1 or more (0 counts as 1).
    pub step: usize,
    /// Of each so many selected scans the middle one is held out, so that scans before and after it are read.
    pub hold_out: Option<usize>,
}

impl Default for Selection {
    fn default() -> Self {
        Self {
            from: 0,
            to: None,
            step: 1,
            hold_out: None,
        }
    }
}

impl Selection {
    /// The position of a scan among the selected ones, those that are held out included.
    fn position(&self, index: usize) -> Option<usize> {
        let within = index >= self.from && self.to.is_none_or(|to| index < to);
        let steps = within.then(|| index - self.from)?;
        steps.is_multiple_of(self.step.max(1)).then(|| steps / self.step.max(1))
    }

    /// Whether every `every`-th scan being held out, the one at this position is.
    fn is_middle(position: usize, every: Option<usize>) -> bool {
        every.is_some_and(|every| every > 0 && position % every == every / 2)
    }

    /// Whether a scan is selected and not held out.
    pub fn contains(&self, index: usize) -> bool {
        self.position(index)
            .is_some_and(|position| !Self::is_middle(position, self.hold_out))
    }

    /// Whether a scan is held out.
    pub fn is_held_out(&self, index: usize) -> bool {
        self.position(index)
            .is_some_and(|position| Self::is_middle(position, self.hold_out))
    }

    /// Whether no later scan can be selected.
    pub fn is_over(&self, index: usize) -> bool {
        self.to.is_some_and(|to| index >= to)
    }

    /// The numbers of the selected scans of a log with `len` scans, without the held-out ones.
    pub fn indices(&self, len: usize) -> Vec<usize> {
        self.all(len).filter(|&index| self.contains(index)).collect()
    }

    /// The numbers of the held-out scans of a log with `len` scans.
    pub fn held_out_indices(&self, len: usize) -> Vec<usize> {
        self.all(len).filter(|&index| self.is_held_out(index)).collect()
    }

    fn all(&self, len: usize) -> impl Iterator<Item = usize> + use<> {
        (self.from..self.to.unwrap_or(len).min(len)).step_by(self.step.max(1))
    }
}

impl Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let to = self.to.map_or(String::new(), |to| to.to_string());
        write!(f, "{}..{to}:{}", self.from, self.step)
    }
}

impl FromStr for Selection {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || "FROM..TO or FROM..TO:STEP is wanted, as in 0..80:2; FROM or TO may be left out".to_owned();
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| wanted());
        let (range, step) = text
            .split_once(':')
            .map_or((text, None), |(range, step)| (range, Some(step)));
        let (from, to) = range.split_once("..").ok_or_else(wanted)?;
        let selection = Self {
            from: if from.is_empty() { 0 } else { number(from)? },
            to: if to.is_empty() { None } else { Some(number(to)?) },
            step: step.map_or(Ok(1), number)?,
            hold_out: None,
        };
        match selection {
            Self { step: 0, .. } => Err("a step is 1 or more".to_owned()),
            Self { from, to: Some(to), .. } if from >= to => Err("it selects no scan".to_owned()),
            selection => Ok(selection),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_selected_by_range_and_step() {
        let select = |text: &str| text.parse::<Selection>().map(|s| (s.from, s.to, s.step));
        assert_eq!(select("0..80"), Ok((0, Some(80), 1)));
        assert_eq!(select("5..80:3"), Ok((5, Some(80), 3)));
        assert_eq!(select("5.."), Ok((5, None, 1)));
        assert_eq!(select("..7:2"), Ok((0, Some(7), 2)));
        for bad in ["", "5", "a..b", "-1..3", "0..5:", "0..5:0", "5..5", "7..3", "0..5:x"] {
            assert!(select(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_selection_reads_back_as_it_was() {
        for text in ["0..80:1", "5..80:3", "5..:2"] {
            assert_eq!(text.parse::<Selection>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn the_middle_one_of_each_group_is_held_out() {
        let of = |from, to, step, every, len| {
            let selection = Selection {
                from,
                to,
                step,
                hold_out: Some(every),
            };
            (selection.indices(len), selection.held_out_indices(len))
        };
        assert_eq!(of(0, None, 1, 10, 25).1, [5, 15]);
        assert_eq!(of(10, Some(35), 1, 10, 99).1, [15, 25]);
        assert_eq!(of(0, None, 2, 3, 12), (vec![0, 4, 6, 10], vec![2, 8]));
        assert_eq!(of(7, None, 1, 2, 5), (vec![], vec![]));
        assert_eq!(of(0, None, 1, 0, 3), (vec![0, 1, 2], vec![]));
    }

    /// With or without knowing the length, the same scans.
    #[test]
    fn each_scan_is_selected_held_out_or_neither() {
        for (from, to, step, hold_out) in [(0, None, 1, None), (3, Some(40), 4, Some(3)), (2, Some(9), 0, Some(2))] {
            let selection = Selection {
                from,
                to,
                step,
                hold_out,
            };
            let of = |is: &dyn Fn(usize) -> bool| (0..50).filter(|&i| is(i)).collect::<Vec<_>>();
            assert_eq!(of(&|i| selection.contains(i)), selection.indices(50));
            assert_eq!(of(&|i| selection.is_held_out(i)), selection.held_out_indices(50));
            assert!((0..50).all(|i| !selection.is_over(i) || !selection.contains(i)));
        }
    }
}
