use std::path::PathBuf;

use super::*;
use crate::Log;

/// A packet of a VLP-16, all returns at one range, the first block at an azimuth.
fn vlp16(azimuth: u16, range: u16, micros: u32) -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12 {
        packet.extend([0xFF, 0xEE]);
        packet.extend(((azimuth + block * 40) % 36_000).to_le_bytes());
        (0..32).for_each(|_| packet.extend([range as u8, (range >> 8) as u8, 9]));
    }
    packet.extend(micros.to_le_bytes());
    packet.extend([0x37, 0x22]);
    packet
}

/// A frame of the network with a datagram.
fn frame(source: [u8; 4], port: u16, payload: &[u8]) -> Vec<u8> {
    let builder = etherparse::PacketBuilder::ethernet2([1; 6], [2; 6])
        .ipv4(source, [255; 4], 64)
        .udp(port, port);
    let mut frame = Vec::new();
    builder.write(&mut frame, payload).unwrap();
    frame
}

fn pcap(frames: &[(i64, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = vec![
        0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 1, 0, 0, 0,
    ];
    for (ns, frame) in frames {
        bytes.extend(((ns / 1_000_000_000) as u32).to_le_bytes());
        bytes.extend(((ns % 1_000_000_000 / 1000) as u32).to_le_bytes());
        (0..2).for_each(|_| bytes.extend((frame.len() as u32).to_le_bytes()));
        bytes.extend(frame);
    }
    bytes
}

/// The same as a pcapng of either byte order, with times in nanoseconds.
fn pcapng(frames: &[(i64, Vec<u8>)], is_big: bool) -> Vec<u8> {
    let u32 = |v: u32| if is_big { v.to_be_bytes() } else { v.to_le_bytes() };
    let u16 = |v: u16| if is_big { v.to_be_bytes() } else { v.to_le_bytes() };
    let block = |kind: u32, body: &[u8]| {
        let length = u32(12 + body.len() as u32);
        [&u32(kind)[..], &length, body, &length].concat()
    };
    let mut bytes = block(
        0x0A0D_0D0A,
        &[&u32(0x1A2B_3C4D)[..], &u16(1), &u16(0), &[0xFF; 8]].concat(),
    );
    let resolution = [&u16(9)[..], &u16(1), &[9, 0, 0, 0], &[0; 4]].concat();
    bytes.extend(block(1, &[&u16(1)[..], &u16(0), &u32(0), &resolution].concat()));
    // A block of an unknown kind is passed over.
    bytes.extend(block(0x7777, &[1; 8]));
    for (ns, frame) in frames {
        let mut body = [
            u32(0),
            u32((ns >> 32) as u32),
            u32(*ns as u32),
            u32(frame.len() as u32),
            u32(frame.len() as u32),
        ]
        .concat();
        body.extend(frame);
        body.resize(body.len().next_multiple_of(4), 0);
        bytes.extend(block(6, &body));
    }
    bytes
}

/// Three and a half turns of a sensor that begin at 200°; each turn at another range.
fn turns(source: [u8; 4], port: u16, late_ns: i64) -> Vec<(i64, Vec<u8>)> {
    let begin_ns = 1_600_000_000_000_000_000_i64;
    let packet = |i: i64| {
        let azimuth = (20_000 + 480 * i) % 36_000;
        let turn = (20_000 + 480 * i) / 36_000;
        let ns = 1_327_104 * i;
        // 1 600 000 000 s are 1600 s into the hour.
        let micros = (1_600_000_000 + (ns + late_ns) / 1000) as u32 % 3_600_000_000;
        let payload = vlp16(azimuth as u16, (1000 + 500 * turn) as u16, micros);
        (begin_ns + ns, frame(source, port, &payload))
    };
    (0..260).map(packet).collect()
}

fn written(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.pcap");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn opened(path: &Path) -> Log {
    crate::open(path).unwrap()
}

#[test]
fn sweeps_are_read_in_any_order_from_any_kind_of_capture() {
    let frames = turns([10, 0, 0, 1], 2368, 0);
    for bytes in [pcap(&frames), pcapng(&frames, false), pcapng(&frames, true)] {
        let (_folder, path) = written(&bytes);
        let log = opened(&path);
        // 160° at the begin are less than half a turn, and so is the end.
        assert_eq!(
            (log.len(), log.sensors()[0].name.as_str()),
            (Some(3), "vlp16"),
            "{:?}",
            log.notes()
        );
        assert!(
            log.notes()
                .iter()
                .any(|note| note == "vlp16: 260 packets from 10.0.0.1:2368, 0 lost")
        );
        let model = log.sensors()[0].model.clone().unwrap();
        assert_eq!((model.rings(), model.columns), (16, 1800));
        for index in [2, 0, 1] {
            let scan = log.read(index).unwrap();
            // Packets lie across 0°, so that a turn has as many returns as fit, on both sides of its ends.
            assert!((28_000..29_200).contains(&scan.points.len()), "{}", scan.points.len());
            let range = 2.0 + f32::from(u16::try_from(index).unwrap()) + 1.0;
            let far = scan.points.iter().filter(|p| (p.length() - range).abs() > 1e-3).count();
            // Of the packet across 0°, whose blocks have one range.
            assert!(far < 400, "{far} at {index}");
            assert_eq!(scan.time_ns, log.scans()[index].time_ns);
            let times = scan.times.unwrap();
            assert!(times[0] == 0.0 && times.iter().all(|t| (0.0..0.1002).contains(t)));
        }
        let second_ns = log.scans()[1].time_ns.unwrap();
        let passed_ns = second_ns - log.scans()[0].time_ns.unwrap();
        assert!((passed_ns - 99_532_800).abs() < 200_000, "{passed_ns}");
        assert!((second_ns - 1_600_000_000_000_000_000).abs() < 300_000_000);
        assert!(log.read(3).is_err());
    }
}

/// A packet that passes on what a GNSS receiver told, sent at these microseconds in the hour.
fn position(micros: u32, time: &str, status: &str) -> Vec<u8> {
    let text = format!("GPRMC,{time},{status},4830.0,N,01100.0,E,0.0,0.0,130920,,");
    let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
    let sentence = format!("${text}*{sum:02X}\r\n");
    let mut packet = vec![0; 512];
    packet[198..202].copy_from_slice(&micros.to_le_bytes());
    packet[206..206 + sentence.len()].copy_from_slice(sentence.as_bytes());
    packet
}

/// Velodyne's sensors pass on what a GNSS receiver tells, hundreds of times a second.
#[test]
fn places_of_a_receiver_at_the_sensor_are_fixes() {
    // 1 600 000 000 s are 12:26:40.
    let begin_ns = 1_600_000_000_000_000_000_i64;
    let with_positions = |source: [u8; 4], late_ns: i64| {
        let packets = turns([10, 0, 0, 1], 2368, late_ns).into_iter();
        let frames = packets.enumerate().flat_map(|(i, (ns, packet))| {
            let micros = 1_600_000_000 + (ns - begin_ns + late_ns) / 1000;
            let (time, status) = match i {
                0..120 => ("122640.00", "A"),
                120..160 => ("122640.10", "V"),
                _ => ("122640.20", "A"),
            };
            let position = frame(source, 8308, &position(micros as u32, time, status));
            [(ns, position), (ns, packet)]
        });
        written(&pcap(&frames.collect::<Vec<_>>()))
    };
    let times = |log: &Log| -> Vec<i64> {
        let fixes = log.gnss().unwrap();
        assert!(
            fixes
                .iter()
                .all(|fix| (fix.latitude_deg, fix.longitude_deg) == (48.5, 11.0))
        );
        assert!(
            fixes
                .iter()
                .all(|fix| fix.altitude_m.is_none() && fix.sigma_m.is_none())
        );
        fixes.iter().map(|fix| fix.time_ns).collect()
    };
    let (_folder, path) = with_positions([10, 0, 0, 1], 0);
    let plain = opened(&path);
    // Where the model is named, a position is not taken for a packet of its returns.
    let named = OpenOptions {
        sensors: vec!["vlp16".to_owned()],
        ..Default::default()
    };
    for log in [plain, crate::open_with(&path, &named).unwrap()] {
        assert_eq!((log.len(), log.sensors().len()), (Some(3), 1));
        assert_eq!(times(&log), [begin_ns, begin_ns + 200_000_000]);
        let told = "vlp16: 1 sentences of its GNSS receiver tell no place or are damaged: left out";
        assert!(log.notes().iter().any(|note| note == told), "{:?}", log.notes());
        // Only of the first packet it was not known yet whose it is.
        let mut others = log.notes().iter().filter(|note| note.contains("other datagrams"));
        assert!(others.all(|note| note == "1 other datagrams are left out"));
    }
    // The sensor's clock does not follow the receiver: then only of the second place it is known when it came.
    let (_folder, path) = with_positions([10, 0, 0, 1], 20_000_000_000);
    assert_eq!(times(&opened(&path)), [begin_ns + 20_212_336_000]);
    // Nor are they those of another sensor.
    let (_folder, path) = with_positions([10, 0, 0, 7], 0);
    let log = opened(&path);
    assert!(times(&log).is_empty());
    assert!(
        log.notes()
            .iter()
            .any(|note| note == "260 other datagrams are left out")
    );
}

#[test]
fn sensors_are_told_apart_by_where_they_send_from() {
    let (a, b) = (turns([10, 0, 0, 1], 2368, 0), turns([10, 0, 0, 2], 2368, 1_000_000_000));
    let other = (1_600_000_000_000_000_000, frame([10, 0, 0, 3], 9000, b"hello"));
    let frames: Vec<_> = std::iter::once(other)
        .chain(a.into_iter().zip(b).flat_map(|(a, b)| [a, b]))
        .collect();
    let (_folder, path) = written(&pcap(&frames));
    let names = ["vlp16@10.0.0.1:2368", "vlp16@10.0.0.2:2368"];
    let named = |names: &[&str]| {
        let options = OpenOptions {
            sensors: names.iter().map(|&name| name.to_owned()).collect(),
            ..Default::default()
        };
        crate::open_with(&path, &options).unwrap()
    };
    // Nobody tells where one sits relative to the other.
    let first = named(&[]);
    assert_eq!((first.len(), first.sensors()[0].name.as_str()), (Some(3), names[0]));
    let note = format!(
        "{} is not read: where it sits relative to {} is not told; --sensor {} would choose it",
        names[1], names[0], names[1]
    );
    assert!(first.notes().contains(&note), "{:?}", first.notes());
    let log = named(&names);
    assert_eq!((log.len(), log.sensors().len()), (Some(6), 2));
    let order: Vec<_> = log.scans().iter().map(|s| s.sensor).collect();
    assert!(log.scans().is_sorted_by_key(|s| s.time_ns) && order.contains(&0) && order.contains(&1));
    assert!(log.notes().iter().any(|note| note == "1 other datagrams are left out"));
    let one = named(&names[1..]);
    assert_eq!((one.len(), one.sensors().len()), (Some(3), 1));
    let none = crate::open_with(
        &path,
        &OpenOptions {
            sensors: vec!["roof".into()],
            ..Default::default()
        },
    );
    assert!(
        none.unwrap_err()
            .to_string()
            .ends_with("there are: vlp16@10.0.0.1:2368, vlp16@10.0.0.2:2368")
    );
}

/// Long datagrams come in fragments of IP, also out of order.
#[test]
fn fragments_are_put_together() {
    let packets = turns([10, 0, 0, 1], 2368, 0);
    let mut frames = Vec::new();
    for (i, (ns, whole)) in packets.iter().enumerate() {
        let datagram = &whole[34..];
        let (first, second) = datagram.split_at(800);
        let fragment = |offset: u16, more: bool, part: &[u8]| {
            let mut bytes = whole[..34].to_vec();
            bytes[16..18].copy_from_slice(&(20 + part.len() as u16).to_be_bytes());
            bytes[18..20].copy_from_slice(&(i as u16).to_be_bytes());
            bytes[20..22].copy_from_slice(&((offset / 8) | (u16::from(more) << 13)).to_be_bytes());
            bytes.extend(part);
            (*ns, bytes)
        };
        let mut parts = [fragment(0, true, first), fragment(800, false, second)];
        if i % 3 == 0 {
            parts.reverse();
        }
        frames.extend(parts);
    }
    let (_whole, whole) = written(&pcap(&packets));
    let (_parts, parts) = written(&pcap(&frames));
    let (whole, parts) = (opened(&whole), opened(&parts));
    assert_eq!(whole.len(), parts.len());
    for index in 0..3 {
        let (a, b) = (whole.read(index).unwrap(), parts.read(index).unwrap());
        assert!(a.points == b.points && a.times == b.times && a.rings == b.rings);
    }
}

#[test]
fn a_capture_that_was_cut_off_is_read_up_to_there() {
    let frames = turns([10, 0, 0, 1], 2368, 0);
    let whole = pcap(&frames);
    let (_folder, path) = written(&whole[..whole.len() - 100]);
    let log = opened(&path);
    assert_eq!(log.len(), Some(3));
    let begin = whole.len() - 16 - frames[0].1.len();
    let told = format!("the capture ends within a record at byte {begin}: what comes after is left out");
    assert!(log.notes().contains(&told), "{:?}", log.notes());
}

#[test]
fn what_is_no_capture_of_a_lidar_is_told() {
    let told = |bytes: &[u8]| {
        let (_folder, path) = written(bytes);
        let told = crate::open(&path).unwrap_err().to_string();
        told.split_once("drive.pcap: ").unwrap().1.to_owned()
    };
    assert_eq!(told(&pcap(&[])), "holds no packets of a LiDAR that is known");
    assert_eq!(
        told(&pcap(&[(0, frame([1; 4], 80, b"GET"))])),
        "holds no packets of a LiDAR that is known"
    );
    let mut long = pcap(&[]);
    long.extend([0, 0, 0, 0, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0x7F, 0, 0, 0, 0]);
    assert!(told(&long).contains("has a record of 2147483647 bytes at byte 24"));
    assert!(told(&pcapng(&[], false)[..40]).contains("ends within a block"));
    assert!(told(&[0x0A, 0x0D, 0x0D, 0x0A]).contains("ends within a block at byte 0"));
    // An Ouster without its metadata.
    let ouster = vec![1; 64 + 16 * (12 + 12 * 32)];
    assert!(told(&pcap(&[(0, frame([1; 4], 7502, &ouster))])).contains("needs its metadata"));
}

/// Poses beside: of the sensor's clock, and of the receiver's where that is another one.
#[test]
fn poses_are_taken_on_either_clock() {
    let late_ns = 20_000_000_000_i64;
    let (folder, path) = written(&pcap(&turns([10, 0, 0, 1], 2368, late_ns)));
    let begin_secs = 1_600_000_000.0;
    for begin_secs in [begin_secs, begin_secs + 20.0] {
        let line = |i: i32| format!("{:.3} {i} 0 0 0 0 0 1\n", begin_secs - 0.5 + 0.1 * f64::from(i));
        let poses = folder.path().join("poses.tum");
        std::fs::write(&poses, (0..20).map(line).collect::<String>()).unwrap();
        let log = crate::open_with(
            &path,
            &OpenOptions {
                poses: Some(poses),
                ..Default::default()
            },
        )
        .unwrap();
        let scan = log.read(1).unwrap();
        let x = scan.pose.unwrap().translation.x;
        // Ten metres a second.
        let want = (scan.time_ns.unwrap() as f64 * 1e-9 - begin_secs + 0.5) * 10.0;
        assert!((x - want).abs() < 1e-3 && !scan.motion.is_empty(), "{x} {want}");
    }
}

/// `tcpdump -C` and Wireshark split a capture into files with a header each.
#[test]
fn a_split_capture_is_one() {
    let frames = turns([10, 0, 0, 5], 2368, 0);
    type Container = fn(&[(i64, Vec<u8>)]) -> Vec<u8>;
    let kinds: [Container; 2] = [pcap, |frames| pcapng(frames, false)];
    for write in kinds {
        let (_whole, path) = written(&write(&frames));
        let whole = opened(&path);
        let folder = tempfile::tempdir().unwrap();
        for (k, part) in frames.chunks(frames.len() / 3 + 1).enumerate() {
            std::fs::write(folder.path().join(format!("drive.pcap{k}")), write(part)).unwrap();
        }
        let split = opened(folder.path());
        assert!(whole.len() > Some(1));
        assert_eq!((split.len(), split.notes()), (whole.len(), whole.notes()));
        for index in (0..whole.len().unwrap()).rev() {
            let [a, b] = [&split, &whole].map(|log| log.read(index).unwrap());
            assert_eq!((a.points, a.times, a.rings), (b.points, b.times, b.rings));
        }
        // A file of another kind among them.
        let other = pcap(&[])[..24].iter().copied().chain([0; 30]).collect::<Vec<u8>>();
        let other = if write(&[])[..4] == other[..4] {
            pcapng(&[], true)
        } else {
            other
        };
        std::fs::write(folder.path().join("drive.pcap9"), other).unwrap();
        let told = crate::open(folder.path()).unwrap_err().to_string();
        assert!(told.contains("drive.pcap9 is a capture of another kind than"), "{told}");
    }
}
