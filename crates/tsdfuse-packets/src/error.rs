//! What can be wrong with a packet or a calibration.

/// The error of this crate: one sentence without the name of a file, which its caller knows.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// A packet is not what the sensor sends.
    #[error("a packet {0}")]
    Packet(String),
    /// A calibration cannot be used.
    #[error("{0}")]
    Calibration(String),
}

impl PacketError {
    pub(crate) fn packet(reason: impl Into<String>) -> Self {
        Self::Packet(reason.into())
    }

    pub(crate) fn calibration(reason: impl Into<String>) -> Self {
        Self::Calibration(reason.into())
    }
}

/// Result with this crate's [`PacketError`].
pub type Result<T, E = PacketError> = std::result::Result<T, E>;
