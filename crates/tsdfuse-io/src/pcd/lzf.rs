//! LZF, the compression of PCL.

/// The most bytes that one byte of input can become: three bytes repeat up to 264.
const MAX_EXPANSION: usize = 88;

/// How far back a repetition reaches at most.
const MAX_BACK: usize = 1 << 13;

/// Bytes that were handed out are dropped once they are as many as this.
const DROP_AT: usize = 1 << 16;

/// Decompresses piece by piece; holds no more than some 64 KiB and the piece that is taken.
///
/// A control byte `c < 32` is followed by `c + 1` literal bytes. Any other repeats, from `1 + offset` bytes back,
/// `2 + length` bytes: length = `c >> 5` (7: plus the next byte), offset = the lower five bits of `c` and the next byte.
pub(super) struct Decompress<'a> {
    input: &'a [u8],
    output: Vec<u8>,
    /// How many bytes of `output` were taken.
    taken: usize,
}

impl<'a> Decompress<'a> {
    /// Begins with `input`, which should become `size` bytes; `None` if it cannot.
    pub(super) fn new(input: &'a [u8], size: usize) -> Option<Self> {
        (size <= input.len().saturating_mul(MAX_EXPANSION)).then(|| Self {
            input,
            output: Vec::with_capacity(DROP_AT + MAX_BACK + 512),
            taken: 0,
        })
    }

    /// The next `n` bytes, or `None` if the input is damaged or ends before them.
    pub(super) fn take(&mut self, n: usize) -> Option<&[u8]> {
        while self.output.len() - self.taken < n {
            self.decode()?;
        }
        self.taken += n;
        self.output.get(self.taken - n..self.taken)
    }

    /// Skips the next `n` bytes.
    pub(super) fn skip(&mut self, mut n: usize) -> Option<()> {
        while n > 0 {
            let piece = n.min(MAX_BACK);
            self.take(piece)?;
            n -= piece;
        }
        Some(())
    }

    /// Whether all bytes were taken and the input is used up.
    pub(super) fn is_at_end(&self) -> bool {
        self.taken == self.output.len() && self.input.is_empty()
    }

    /// Decodes what one control byte stands for.
    fn decode(&mut self) -> Option<()> {
        if self.taken >= DROP_AT {
            let drop = self.taken - MAX_BACK;
            self.output.drain(..drop);
            self.taken -= drop;
        }
        let control = usize::from(self.byte()?);
        if control < 32 {
            let (literal, rest) = self.input.split_at_checked(control + 1)?;
            self.output.extend_from_slice(literal);
            self.input = rest;
            return Some(());
        }
        let mut length = (control >> 5) + 2;
        if length == 9 {
            length += usize::from(self.byte()?);
        }
        let back = ((control & 31) << 8) + usize::from(self.byte()?) + 1;
        let start = self.output.len().checked_sub(back)?;
        // The copy may run into what it has just written.
        for i in start..start + length {
            self.output.push(*self.output.get(i)?);
        }
        Some(())
    }

    fn byte(&mut self) -> Option<u8> {
        let (&byte, rest) = self.input.split_first()?;
        self.input = rest;
        Some(byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// All at once: the slow and obvious way.
    fn decompress(input: &[u8], size: usize) -> Option<Vec<u8>> {
        let (mut output, mut rest) = (Vec::new(), input.iter());
        while let Some(&control) = rest.next() {
            let control = usize::from(control);
            if control < 32 {
                let (literal, after) = rest.as_slice().split_at_checked(control + 1)?;
                output.extend_from_slice(literal);
                rest = after.iter();
                continue;
            }
            let mut length = (control >> 5) + 2;
            if length == 9 {
                length += usize::from(*rest.next()?);
            }
            let back = ((control & 31) << 8) + usize::from(*rest.next()?) + 1;
            let start = output.len().checked_sub(back)?;
            for i in start..start + length {
                output.push(*output.get(i)?);
            }
        }
        (output.len() == size).then_some(output)
    }

    /// In pieces of some sizes, one after the other and again; every third is skipped and stays zero.
    fn in_pieces(input: &[u8], size: usize, pieces: &[usize]) -> Option<Vec<u8>> {
        let (mut bytes, mut output) = (Decompress::new(input, size)?, vec![0; size]);
        let (mut at, mut pieces) = (0, pieces.iter().cycle().enumerate());
        while at < size {
            let (i, &piece) = pieces.next()?;
            let piece = piece.min(size - at);
            match i % 3 {
                2 => bytes.skip(piece)?,
                _ => output[at..at + piece].copy_from_slice(bytes.take(piece)?),
            }
            at += piece;
        }
        bytes.is_at_end().then_some(output)
    }

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
            prop_assert_eq!(in_pieces(&packed, data.len(), &[usize::MAX]), Some(data.clone()));
            prop_assert_eq!(in_pieces(&packed, data.len() + 1, &[usize::MAX]), None);
            if let Some(less) = data.len().checked_sub(1) {
                prop_assert_eq!(in_pieces(&packed, less, &[usize::MAX]), None);
            }
        }

        #[test]
        fn pieces_are_those_of_the_whole(bytes in prop::collection::vec(any::<u8>(), 0..100), size in 0usize..2000) {
            let whole = decompress(&bytes, size);
            prop_assert_eq!(in_pieces(&bytes, size, &[usize::MAX]), whole.clone());
            let skipped = in_pieces(&bytes, size, &[1, 300, 7, 2]).zip(whole);
            prop_assert!(skipped.is_none_or(|(some, all)| some.iter().zip(all).all(|(a, b)| *a == b || *a == 0)));
        }
    }

    #[test]
    fn what_was_taken_is_forgotten_but_for_what_may_repeat() {
        // Different bytes, then runs that repeat from as far back as is possible.
        let mut packed: Vec<u8> = (0..8192u32).flat_map(|i| [0, (i * i / 7) as u8]).collect();
        packed.extend([0xff, 255, 0xff].repeat(2000));
        let size = 8192 + 2000 * 264;
        let whole = decompress(&packed, size).unwrap();
        assert!(in_pieces(&packed, size, &[4, 2]).is_some());
        let mut bytes = Decompress::new(&packed, size).unwrap();
        for piece in whole.chunks(12) {
            assert_eq!(bytes.take(piece.len()), Some(piece));
            assert!(bytes.output.len() < DROP_AT + MAX_BACK + 512);
        }
        assert!(bytes.is_at_end());
    }

    #[test]
    fn damage_is_noticed() {
        let decompress = |input, size| in_pieces(input, size, &[usize::MAX]);
        assert_eq!(decompress(&[0x20, 0x00], 3), None, "repeats what is not there");
        assert_eq!(decompress(&[0x05, 1, 2], 6), None, "literals are missing");
        assert_eq!(decompress(&[0xe0], 9), None, "length is missing");
        assert!(Decompress::new(&[0, 1], usize::MAX).is_none(), "more than can be");
    }
}
