//! glTF's numbers for the types of a buffer's entries.

pub(super) const F32: u32 = 5126;
pub(super) const U32: u32 = 5125;
pub(super) const U8: u32 = 5121;
