//! LZF, the compression of PCL.

/// The most bytes that one byte of input can become: three bytes repeat up to 264.
const MAX_EXPANSION: usize = 88;

/// Decompresses to exactly `size` bytes; `None` if the data do not give that many.
///
/// A control byte `c < 32` is followed by `c + 1` literal bytes. Any other repeats, from `1 + offset` bytes back,
/// `2 + length` bytes: length = `c >> 5` (7: plus the next byte), offset = the lower five bits of `c` and the next byte.
pub(super) fn decompress(input: &[u8], size: usize) -> Option<Vec<u8>> {
    if size > input.len().saturating_mul(MAX_EXPANSION) {
        return None;
    }
    let mut output = Vec::with_capacity(size);
    let mut rest = input.iter();
    while let Some(&control) = rest.next() {
        let control = usize::from(control);
        if control < 32 {
            let (literal, after) = rest.as_slice().split_at_checked(control + 1)?;
            output.extend_from_slice(literal);
            rest = after.iter();
        } else {
            let mut length = (control >> 5) + 2;
            if length == 9 {
                length += usize::from(*rest.next()?);
            }
            let back = ((control & 31) << 8) + usize::from(*rest.next()?) + 1;
            let start = output.len().checked_sub(back)?;
            // The copy may run into what it has just written.
            for i in start..start + length {
                output.push(*output.get(i)?);
            }
        }
        if output.len() > size {
            return None;
        }
    }
    (output.len() == size).then_some(output)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Compresses by looking for each repetition in the last few bytes.
    fn compress(data: &[u8]) -> Vec<u8> {
        let (mut packed, mut at) = (Vec::new(), 0);
        while at < data.len() {
            let same = |back: usize| {
                (at..data.len().min(at + 264))
                    .take_while(|&i| data[i] == data[i - back])
                    .count()
            };
            let (length, back) = (1..=at.min(40)).map(|back| (same(back), back)).max().unwrap_or((0, 1));
            if length < 3 {
                packed.extend([0, data[at]]);
                at += 1;
                continue;
            }
            let short = (length - 2).min(7);
            packed.push((short << 5) as u8 + ((back - 1) >> 8) as u8);
            packed.extend((short == 7).then(|| (length - 9) as u8));
            packed.push((back - 1) as u8);
            at += length;
        }
        packed
    }

    proptest! {
        #[test]
        fn what_was_compressed_comes_back(runs in prop::collection::vec((0u8..4, 1usize..300), 0..20)) {
            let data: Vec<u8> = runs.iter().flat_map(|&(byte, n)| std::iter::repeat_n(byte, n)).collect();
            let packed = compress(&data);
            prop_assert_eq!(decompress(&packed, data.len()), Some(data.clone()));
            prop_assert_eq!(decompress(&packed, data.len() + 1), None);
            if let Some(less) = data.len().checked_sub(1) {
                prop_assert_eq!(decompress(&packed, less), None);
            }
        }

        #[test]
        fn any_bytes_are_bearable(bytes in prop::collection::vec(any::<u8>(), 0..100), size in 0usize..2000) {
            let out = decompress(&bytes, size);
            prop_assert!(out.is_none_or(|out| out.len() == size));
        }
    }

    #[test]
    fn damage_is_noticed() {
        assert_eq!(decompress(&[0x20, 0x00], 3), None, "repeats what is not there");
        assert_eq!(decompress(&[0x05, 1, 2], 6), None, "literals are missing");
        assert_eq!(decompress(&[0xe0], 9), None, "length is missing");
        assert_eq!(decompress(&[0, 1], usize::MAX), None, "more than can be");
    }
}
