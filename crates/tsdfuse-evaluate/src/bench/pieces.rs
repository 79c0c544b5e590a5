//! Splitting a list into pieces.

/// At most `count` pieces of nearly the same length.
pub(crate) fn pieces<T>(all: &[T], count: usize) -> impl Iterator<Item = &[T]> {
    let count = count.min(all.len());
    (0..count).map(move |i| &all[i * all.len() / count..(i + 1) * all.len() / count])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_hold_every_scan_once() {
        let scans: Vec<usize> = (5..34).collect();
        for count in [1, 2, 12, 29, 99] {
            let pieces: Vec<_> = pieces(&scans, count).collect();
            assert_eq!(pieces.concat(), scans);
            assert_eq!(pieces.len(), count.min(29));
            assert!(pieces.iter().all(|piece| !piece.is_empty()));
        }
        assert_eq!(pieces::<usize>(&[], 3).count(), 0);
    }
}
