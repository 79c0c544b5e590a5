//! As much of SQLite and of CDR as these recordings need, so that decoders are tested apart from the reader of bags.

/// Time of receipt and bytes of each packet of a ROS 2 bag with one topic of packets, in order.
pub(crate) fn packets(db: &[u8]) -> Vec<(i64, Vec<u8>)> {
    let page_size = usize::from(u16::from_be_bytes([db[16], db[17]]));
    let mut messages: Vec<(u64, Vec<u8>)> = Vec::new();
    for (number, page) in db.chunks_exact(page_size).enumerate() {
        let head = if number == 0 { 100 } else { 0 };
        // A leaf of a table.
        if page[head] != 0x0D {
            continue;
        }
        let cells = usize::from(u16::from_be_bytes([page[head + 3], page[head + 4]]));
        for cell in 0..cells {
            let at = head + 8 + 2 * cell;
            let mut at = usize::from(u16::from_be_bytes([page[at], page[at + 1]]));
            let size = varint(page, &mut at) as usize;
            let row = varint(page, &mut at);
            let (payload, mut header) = (payload(db, page_size, page, at, size), 0);
            let end = varint(&payload, &mut header) as usize;
            let types: Vec<u64> =
                std::iter::from_fn(|| (header < end).then(|| varint(&payload, &mut header))).collect();
            // id, topic, timestamp, data: a blob of some size.
            if let &[_, _, _, blob] = types.as_slice()
                && blob > 2000
                && blob % 2 == 0
            {
                messages.push((row, payload[size - (blob as usize - 12) / 2..].to_vec()));
            }
        }
    }
    messages.sort_by_key(|(row, _)| *row);
    messages.iter().flat_map(|(_, message)| scan(message)).collect()
}

/// A cell's bytes, with what lies on further pages.
fn payload(db: &[u8], page_size: usize, page: &[u8], at: usize, size: usize) -> Vec<u8> {
    let (most, least) = (page_size - 35, (page_size - 12) * 32 / 255 - 23);
    if size <= most {
        return page[at..at + size].to_vec();
    }
    let local = least + (size - least) % (page_size - 4);
    let local = if local <= most { local } else { least };
    let mut bytes = page[at..at + local].to_vec();
    let pointer = |b: &[u8]| u32::from_be_bytes(b[..4].try_into().unwrap()) as usize;
    let mut next = pointer(&page[at + local..]);
    while bytes.len() < size {
        let page = &db[(next - 1) * page_size..next * page_size];
        let take = (size - bytes.len()).min(page_size - 4);
        bytes.extend(&page[4..4 + take]);
        next = pointer(page);
    }
    bytes
}

fn varint(bytes: &[u8], at: &mut usize) -> u64 {
    let mut value = 0;
    for i in 0..9 {
        let byte = bytes[*at];
        *at += 1;
        if i == 8 {
            return value << 8 | u64::from(byte);
        }
        value = value << 7 | u64::from(byte & 0x7F);
        if byte < 0x80 {
            break;
        }
    }
    value
}

/// The packets of a `VelodyneScan` or a `PandarScan`: stamp and 1206 bytes, or stamp, 1500 bytes and how many of them count.
fn scan(message: &[u8]) -> Vec<(i64, Vec<u8>)> {
    let body = &message[4..];
    let u32_at = |at: usize| u32::from_le_bytes(body[at..at + 4].try_into().unwrap());
    let aligned = |at: usize| at.next_multiple_of(4);
    let mut at = aligned(12 + u32_at(8) as usize);
    let count = u32_at(at) as usize;
    at += 4;
    let room = (body.len() - at) / count;
    let is_pandar = room >= 1512;
    let mut packets = Vec::new();
    for _ in 0..count {
        let received_ns = i64::from(u32_at(at)) * 1_000_000_000 + i64::from(u32_at(at + 4));
        let (data, size) = if is_pandar {
            (1500, u32_at(at + 1508) as usize)
        } else {
            (1206, 1206)
        };
        packets.push((received_ns, body[at + 8..at + 8 + size].to_vec()));
        at = aligned(at + 8 + data) + if is_pandar { 4 } else { 0 };
    }
    packets
}
