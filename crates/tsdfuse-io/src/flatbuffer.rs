//! As much of FlatBuffers as OSF and Arrow need, with every offset checked: what lies outside of the buffer is not there.

/// A table in a buffer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

fn u32_at(bytes: &[u8], at: usize) -> Option<usize> {
    array(bytes, at).map(|bytes| u32::from_le_bytes(bytes) as usize)
}

impl<'a> Table<'a> {
    /// The root of a buffer that begins with its size.
    pub(crate) fn root(bytes: &'a [u8]) -> Option<Self> {
        let size = u32_at(bytes, 0)?;
        let bytes = bytes.get(4..size.checked_add(4)?)?;
        Self::new(bytes, u32_at(bytes, 0)?)
    }

    /// The root of a buffer that begins with its offset.
    pub(crate) fn root_without_size(bytes: &'a [u8]) -> Option<Self> {
        Self::new(bytes, u32_at(bytes, 0)?)
    }

    fn new(bytes: &'a [u8], at: usize) -> Option<Self> {
        (at < bytes.len()).then_some(Self { bytes, at })
    }

    /// Where the value of a field is; `None` for one that has its default.
    fn field(&self, number: usize) -> Option<usize> {
        let back = i32::from_le_bytes(array(self.bytes, self.at)?);
        let vtable = usize::try_from(i64::try_from(self.at).ok()? - i64::from(back)).ok()?;
        let u16_at = |at: usize| array(self.bytes, at).map(u16::from_le_bytes).map(usize::from);
        let entry = 4 + 2 * number;
        let offset = (entry + 2 <= u16_at(vtable)?).then(|| u16_at(vtable + entry))??;
        (offset > 0).then_some(self.at + offset)
    }

    pub(crate) fn u8(&self, number: usize) -> Option<u8> {
        self.bytes.get(self.field(number)?).copied()
    }

    pub(crate) fn u64(&self, number: usize) -> Option<u64> {
        array(self.bytes, self.field(number)?).map(u64::from_le_bytes)
    }

    pub(crate) fn u32(&self, number: usize) -> Option<u32> {
        array(self.bytes, self.field(number)?).map(u32::from_le_bytes)
    }

    /// The table that a field refers to.
    pub(crate) fn table(&self, number: usize) -> Option<Self> {
        let field = self.field(number)?;
        Self::new(self.bytes, field.checked_add(u32_at(self.bytes, field)?)?)
    }

    /// The elements of a vector of so many bytes each.
    pub(crate) fn vector(&self, number: usize, size: usize) -> Option<std::slice::ChunksExact<'a, u8>> {
        let field = self.field(number)?;
        let begin = field.checked_add(u32_at(self.bytes, field)?)?;
        let bytes = u32_at(self.bytes, begin)?.checked_mul(size)?;
        let begin = begin.checked_add(4)?;
        Some(self.bytes.get(begin..begin.checked_add(bytes)?)?.chunks_exact(size))
    }

    pub(crate) fn bytes(&self, number: usize) -> Option<&'a [u8]> {
        let field = self.field(number)?;
        let begin = field.checked_add(u32_at(self.bytes, field)?)?;
        let end = begin.checked_add(4)?.checked_add(u32_at(self.bytes, begin)?)?;
        self.bytes.get(begin + 4..end)
    }

    pub(crate) fn text(&self, number: usize) -> Option<&'a str> {
        std::str::from_utf8(self.bytes(number)?).ok()
    }

    /// The tables of a vector of tables.
    pub(crate) fn tables(&self, number: usize) -> Option<impl Iterator<Item = Table<'a>> + use<'a>> {
        let (bytes, field) = (self.bytes, self.field(number)?);
        let begin = field.checked_add(u32_at(bytes, field)?)?.checked_add(4)?;
        let offsets = self.vector(number, 4)?.enumerate();
        Some(offsets.filter_map(move |(i, offset)| {
            let at = begin.checked_add(4 * i)?;
            Self::new(bytes, at.checked_add(u32_at(offset, 0)?)?)
        }))
    }
}
