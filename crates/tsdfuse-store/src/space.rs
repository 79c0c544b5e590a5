//! Which pages of the file are free.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::format::{Extent, PAGE};

/// The free pages. What is beyond the end is free, too.
#[derive(Debug)]
pub(crate) struct Space {
    /// First pages and numbers of free pages; neighbours are joined.
    free: BTreeMap<u64, u64>,
    end: u64,
}

impl Space {
    /// All pages from `first` on are free, except these; `None` if some of them overlap.
    pub(crate) fn without(first: u64, used: impl IntoIterator<Item = Extent>) -> Option<Self> {
        let mut used: Vec<Range<u64>> = used.into_iter().map(Extent::pages).collect();
        used.sort_unstable_by_key(|pages| (pages.start, pages.end));
        let mut space = Self {
            free: BTreeMap::new(),
            end: first,
        };
        for Range { start, end } in used {
            let gap = start.checked_sub(space.end)?;
            if gap > 0 {
                space.free.insert(space.end, gap);
            }
            space.end = end;
        }
        Some(space)
    }

    /// Takes pages for so many bytes: the first ones that are enough.
    pub(crate) fn take(&mut self, length: u64) -> Extent {
        let pages = length.div_ceil(PAGE);
        let found = self.free.iter().find(|(_, free)| **free >= pages);
        let first = if let Some((&first, &free)) = found {
            self.free.remove(&first);
            if free > pages {
                self.free.insert(first + pages, free - pages);
            }
            first
        } else {
            // What is free at the end is part of it.
            let last = self.free.last_key_value().map(|(&first, &free)| (first, first + free));
            let first = match last {
                Some((first, end)) if end == self.end => {
                    self.free.remove(&first);
                    first
                }
                _ => self.end,
            };
            self.end = first + pages;
            first
        };
        Extent {
            offset: first * PAGE,
            length,
        }
    }

    /// Gives back what was taken.
    pub(crate) fn give_back(&mut self, extent: Extent) {
        let Range { mut start, mut end } = extent.pages();
        if let Some((&before, &pages)) = self.free.range(..start).next_back()
            && before + pages == start
        {
            self.free.remove(&before);
            start = before;
        }
        if let Some(pages) = self.free.remove(&end) {
            end += pages;
        }
        if start < end {
            self.free.insert(start, end - start);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn no_page_is_taken_twice_and_none_is_lost(steps in prop::collection::vec((any::<bool>(), 1..40_000u64), 1..200)) {
            let mut space = Space::without(2, []).unwrap();
            let mut taken: Vec<Extent> = Vec::new();
            for (takes, number) in steps {
                if takes || taken.is_empty() {
                    let extent = space.take(number);
                    prop_assert!(extent.offset >= 2 * PAGE && extent.length == number);
                    taken.push(extent);
                } else {
                    space.give_back(taken.swap_remove(number as usize % taken.len()));
                }
                // The same as one that is made anew, which refuses overlaps.
                let anew = Space::without(2, taken.iter().copied()).unwrap();
                let (free, end) = (&mut space.free, space.end);
                let beyond = free.split_off(&anew.end);
                prop_assert_eq!(&*free, &anew.free);
                prop_assert_eq!(beyond.values().sum::<u64>(), end - anew.end);
                free.extend(beyond);
            }
        }
    }

    #[test]
    fn overlaps_are_refused() {
        let at = |page: u64, pages: u64| Extent {
            offset: page * PAGE,
            length: pages * PAGE,
        };
        assert!(Space::without(2, [at(5, 2), at(2, 3)]).is_some());
        assert!(Space::without(2, [at(5, 2), at(2, 4)]).is_none());
        assert!(Space::without(2, [at(1, 1)]).is_none());
    }
}
