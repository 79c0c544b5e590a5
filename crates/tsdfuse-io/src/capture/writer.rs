//! Writing a capture: PCAP of bare IP packets, with times in nanoseconds.

use std::fs::File;
use std::io::{Error, ErrorKind, Result, Write};
use std::net::SocketAddr;

use etherparse::PacketBuilder;

/// Of the registry of link types: packets of IP, whose first bits tell the version.
const RAW_IP: u32 = 101;
/// Longer frames are cut.
const LONGEST: u32 = 1 << 17;
const TIME_TO_LIVE: u8 = 64;

/// Begins a capture.
pub(crate) fn begin(file: &mut File) -> Result<()> {
    let mut header = Vec::new();
    header.extend(0xA1B2_3C4D_u32.to_le_bytes());
    header.extend([2_u16, 4].iter().flat_map(|version| version.to_le_bytes()));
    header.extend([0, 0, LONGEST, RAW_IP].iter().flat_map(|field| field.to_le_bytes()));
    file.write_all(&header)
}

/// Appends a datagram that one address sent to the other and that was received at `received_ns` (nanoseconds since 1970).
pub(crate) fn append(
    output: &mut impl Write,
    received_ns: i64,
    [from, to]: [SocketAddr; 2],
    payload: &[u8],
) -> Result<()> {
    let builder = match (from, to) {
        (SocketAddr::V4(from), SocketAddr::V4(to)) => {
            PacketBuilder::ipv4(from.ip().octets(), to.ip().octets(), TIME_TO_LIVE)
        }
        (SocketAddr::V6(from), SocketAddr::V6(to)) => {
            PacketBuilder::ipv6(from.ip().octets(), to.ip().octets(), TIME_TO_LIVE)
        }
        _ => return Err(ErrorKind::InvalidInput.into()),
    };
    let builder = builder.udp(from.port(), to.port());
    let length = builder.size(payload.len()) as u32;
    let mut record = Vec::with_capacity(16 + length as usize);
    let secs = received_ns.div_euclid(1_000_000_000) as u32;
    let nanos = received_ns.rem_euclid(1_000_000_000) as u32;
    record.extend(
        [secs, nanos, length, length]
            .iter()
            .flat_map(|field| field.to_le_bytes()),
    );
    builder.write(&mut record, payload).map_err(Error::other)?;
    // At once: half a record must not be what a reader finds last.
    output.write_all(&record)
}
