//! The datagrams (UDP) of a capture, put together from IP fragments where they were too long for the network.

use std::io::Read;
use std::net::IpAddr;

use etherparse::defrag::IpDefragPool;
use etherparse::{EtherType, IpNumber, NetSlice, SlicedPacket, TransportSlice, UdpSlice};

use super::records::{Record, Records};
use crate::error::Result;

/// A fragment whose datagram is not complete after so many further fragments is forgotten.
const PATIENCE: u64 = 512;
/// How often that is done.
const TIDY_EVERY: u64 = 64;

/// From where to where.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Flow {
    pub(crate) source: IpAddr,
    pub(crate) source_port: u16,
    pub(crate) port: u16,
}

/// A datagram.
#[derive(Debug)]
pub(crate) struct Datagram<'a> {
    /// Where the record begins that completes it: unique in the file.
    pub(crate) offset: u64,
    pub(crate) received_ns: i64,
    pub(crate) flow: Flow,
    pub(crate) payload: &'a [u8],
}

/// Reads one datagram after the other.
pub(crate) struct Datagrams<R> {
    records: Records<R>,
    fragments: IpDefragPool<u64, ()>,
    fragment_count: u64,
    payload: Vec<u8>,
    /// Frames of the network that were cut short when they were captured, or are damaged.
    pub(crate) unreadable: u64,
}

impl<R: Read> Datagrams<R> {
    pub(crate) fn new(records: Records<R>) -> Self {
        Self {
            records,
            fragments: IpDefragPool::new(),
            fragment_count: 0,
            payload: Vec::new(),
            unreadable: 0,
        }
    }

    pub(crate) fn records(&self) -> &Records<R> {
        &self.records
    }

    /// The next one; `None` at the end, or where the file is damaged.
    pub(crate) fn next(&mut self) -> Result<Option<Datagram<'_>>> {
        let (offset, received_ns, flow) = loop {
            let Some(record) = self.records.next()? else {
                return Ok(None);
            };
            let Some(sliced) = slice(&record) else {
                self.unreadable += 1;
                continue;
            };
            let source: Option<IpAddr> = match &sliced.net {
                Some(NetSlice::Ipv4(ip)) => Some(ip.header().source_addr().into()),
                Some(NetSlice::Ipv6(ip)) => Some(ip.header().source_addr().into()),
                _ => None,
            };
            let Some(source) = source else { continue };
            self.payload.clear();
            let ports = if sliced.is_ip_payload_fragmented() {
                self.fragment_count += 1;
                let now = self.fragment_count;
                if now.is_multiple_of(TIDY_EVERY) {
                    self.fragments.retain(|&at| at + PATIENCE > now);
                }
                match self.fragments.process_sliced_packet(&sliced, now, ()) {
                    Ok(Some(whole)) => {
                        let udp = UdpSlice::from_slice(&whole.payload)
                            .ok()
                            .filter(|_| whole.ip_number == IpNumber::UDP);
                        let ports = udp.map(|udp| {
                            self.payload.extend_from_slice(udp.payload());
                            (udp.source_port(), udp.destination_port())
                        });
                        self.fragments.return_buf(whole);
                        ports
                    }
                    Ok(None) => None,
                    Err(_) => {
                        self.unreadable += 1;
                        None
                    }
                }
            } else if let Some(TransportSlice::Udp(udp)) = &sliced.transport {
                self.payload.extend_from_slice(udp.payload());
                Some((udp.source_port(), udp.destination_port()))
            } else {
                None
            };
            if let Some((source_port, port)) = ports {
                let flow = Flow {
                    source,
                    source_port,
                    port,
                };
                break (record.offset, record.received_ns, flow);
            }
        };
        Ok(Some(Datagram {
            offset,
            received_ns,
            flow,
            payload: &self.payload,
        }))
    }
}

/// The layers of a frame; `None` where it is cut short, damaged, or of a kind of link that is not known.
fn slice<'a>(record: &Record<'a>) -> Option<SlicedPacket<'a>> {
    let frame = record.frame;
    let ether = |at: usize| {
        let kind = frame.get(at..at + 2).and_then(|kind| kind.try_into().ok());
        kind.map(u16::from_be_bytes).map(EtherType)
    };
    // Numbers of the registry of link types, tcpdump.org/linktypes.html.
    match record.link {
        1 => SlicedPacket::from_ethernet(frame).ok(),
        // The loopback of BSD: four bytes of the address family.
        0 | 108 => SlicedPacket::from_ip(frame.get(4..)?).ok(),
        12 | 14 | 101 | 228 | 229 => SlicedPacket::from_ip(frame).ok(),
        // Cooked captures of Linux: 16 or 20 bytes, the protocol at their end or at their begin.
        113 => SlicedPacket::from_ether_type(ether(14)?, frame.get(16..)?).ok(),
        276 => SlicedPacket::from_ether_type(ether(0)?, frame.get(20..)?).ok(),
        _ => None,
    }
}
