//! What is packed by LZ4, Zstandard or bzip2, unpacked as far as is credible.

use std::io::Read;

/// What unpacks to more than this is refused.
const MAX_CHUNK: u64 = 1 << 30;
/// No compressor makes bytes of clouds this much smaller; chunks of up to [`GRANTED`] may be anything.
const MAX_RATIO: u64 = 1024;
const GRANTED: u64 = 1 << 26;

/// How bytes are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compression {
    None,
    Lz4,
    Zstd,
    Bzip2,
}

impl Compression {
    pub(crate) fn named(name: &str) -> Option<Self> {
        Some(match name {
            "" | "none" => Self::None,
            "lz4" => Self::Lz4,
            "zstd" => Self::Zstd,
            "bz2" => Self::Bzip2,
            _ => return None,
        })
    }

    /// Unpacks `packed`, which must be exactly `unpacked` bytes then; or why that is not possible.
    pub(crate) fn unpack(self, packed: Vec<u8>, unpacked: u64) -> Result<Vec<u8>, String> {
        if self == Self::None {
            return if packed.len() as u64 == unpacked {
                Ok(packed)
            } else {
                Err(format!("has {} bytes, not {unpacked}", packed.len()))
            };
        }
        let granted = (packed.len() as u64)
            .saturating_mul(MAX_RATIO)
            .saturating_add(GRANTED)
            .min(MAX_CHUNK);
        if unpacked > granted {
            return Err(format!(
                "claims to unpack from {} to {unpacked} bytes; more than {granted} are not believed",
                packed.len()
            ));
        }
        let bytes = self.unpack_up_to(&packed, unpacked.saturating_add(1))?;
        if bytes.len() as u64 == unpacked {
            Ok(bytes)
        } else {
            Err(format!("does not unpack to {unpacked} bytes"))
        }
    }

    /// Unpacks at most `limit` bytes. Memory grows with what comes out, not with what is claimed.
    pub(crate) fn unpack_up_to(self, packed: &[u8], limit: u64) -> Result<Vec<u8>, String> {
        fn all(reader: impl Read, limit: u64, guess: usize) -> Result<Vec<u8>, String> {
            let mut bytes = Vec::with_capacity(guess);
            let read = reader.take(limit).read_to_end(&mut bytes);
            read.map_err(|e| format!("is damaged: {e}"))?;
            Ok(bytes)
        }
        let guess = usize::try_from(limit)
            .unwrap_or(usize::MAX)
            .min(packed.len().saturating_mul(8));
        match self {
            Self::None => all(packed, limit, 0),
            Self::Lz4 => all(lz4_flex::frame::FrameDecoder::new(packed), limit, guess),
            Self::Zstd => {
                let decoder = ruzstd::decoding::StreamingDecoder::new(packed);
                all(decoder.map_err(|e| format!("is damaged: {e}"))?, limit, guess)
            }
            Self::Bzip2 => all(bzip2::read::BzDecoder::new(packed), limit, guess),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_claims_to_be_huge_is_not_believed() {
        let zstd = |packed: &[u8], unpacked| Compression::Zstd.unpack(packed.to_vec(), unpacked);
        let claim = zstd(&[0x28, 0xb5, 0x2f, 0xfd, 0], 1 << 40).unwrap_err();
        assert_eq!(
            claim,
            "claims to unpack from 5 to 1099511627776 bytes; more than 67113984 are not believed"
        );
        assert!(zstd(&[0x28, 0xb5, 0x2f, 0xfd, 0], 100).is_err());
    }

    #[test]
    fn what_does_not_unpack_to_what_was_told_is_refused() {
        use std::io::Write;
        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
        encoder.write_all(&[7; 1000]).unwrap();
        let packed = encoder.finish().unwrap();
        assert_eq!(Compression::Lz4.unpack(packed.clone(), 1000), Ok(vec![7; 1000]));
        for wrong in [999, 1001, 0] {
            let told = Compression::Lz4.unpack(packed.clone(), wrong).unwrap_err();
            assert_eq!(told, format!("does not unpack to {wrong} bytes"));
        }
        assert!(Compression::Bzip2.unpack(packed, 1000).is_err());
        assert!(Compression::None.unpack(vec![1], 2).is_err());
    }
}
