use super::*;
use crate::{Calibration as Any, Decoder};

/// A packet of any model: all ranges the same, blocks so far apart, both returns of a firing alike where there are two.
fn packet(sensor: Sensor, azimuth: u16, step: u16, range: u16, mode: u8, micros: u32) -> Vec<u8> {
    let layout = Layout::of(sensor).unwrap();
    let mut bytes = vec![0; layout.tail.time.max(layout.tail.date).max(layout.tail.mode) + 40];
    let version: &[u8] = match sensor {
        Sensor::Qt64 => &[3, 1],
        Sensor::Qt128 => &[3, 2],
        Sensor::Pandar128 => &[1, 3],
        Sensor::Ot128 => &[1, 4],
        _ => &[6, 1],
    };
    match sensor {
        Sensor::Pandar40p => {}
        Sensor::Pandar64 => bytes[..6].copy_from_slice(&[0xEE, 0xFF, 64, 6, 0, 4]),
        _ => {
            bytes[..2].copy_from_slice(&[0xEE, 0xFF]);
            bytes[2..4].copy_from_slice(version);
            bytes[6..12].copy_from_slice(&[layout.lasers as u8, layout.blocks as u8, 1, 4, 2, 0]);
        }
    }
    let returns = if mode == 0x39 { 2 } else { 1 };
    for block in 0..layout.blocks {
        let at = layout.block_at(block);
        if sensor == Sensor::Pandar40p {
            bytes[at..at + 2].copy_from_slice(&[0xFF, 0xEE]);
        }
        let turned = (azimuth + step * (block / returns) as u16) % TURN;
        bytes[at + layout.block_head - 2..at + layout.block_head].copy_from_slice(&turned.to_le_bytes());
        for laser in 0..layout.lasers {
            let at = at + layout.block_head + laser * layout.unit;
            bytes[at..at + 2].copy_from_slice(&range.to_le_bytes());
            bytes[at + 2] = 100;
        }
    }
    let tail = &layout.tail;
    bytes[tail.mode] = mode;
    bytes[tail.speed..tail.speed + 2].copy_from_slice(&600_u16.to_le_bytes());
    let year = (2024 - tail.first_year) as u8;
    bytes[tail.date..tail.date + 6].copy_from_slice(&[year, 2, 29, 12, 30, 15]);
    bytes[tail.time..tail.time + 4].copy_from_slice(&micros.to_le_bytes());
    bytes
}

fn hesai() -> impl Iterator<Item = Sensor> {
    Sensor::ALL.into_iter().filter(|sensor| Layout::of(*sensor).is_some())
}

fn decoder(sensor: Sensor) -> Decoder {
    let lasers = Layout::of(sensor).unwrap().lasers;
    let angles = (1..=lasers).map(|laser| format!("{laser},{},0.5\n", 20.0 - laser as f64 * 0.3));
    let csv: String = std::iter::once("Laser id,Elevation,Azimuth\n".to_owned())
        .chain(angles)
        .collect();
    Decoder::new(sensor, Any::parse(csv.as_bytes()).unwrap()).unwrap()
}

#[test]
fn each_model_is_recognised_and_placed() {
    // 29 February 2024, 12:30:15 UTC.
    let secs = 1_709_209_815;
    for sensor in hesai() {
        let packet = packet(sensor, 9_000, 20, 2_500, 0x37, 250_000);
        assert_eq!(Sensor::recognise(&packet), Some(sensor));
        let mut decoder = decoder(sensor);
        assert!(decoder.push(0, &packet).unwrap().is_none());
        let scan = decoder.finish().unwrap().scan;
        let layout = Layout::of(sensor).unwrap();
        assert_eq!(scan.points.len(), layout.lasers * layout.blocks, "{sensor:?}");
        // 90.5° from y, clockwise, 10 m away, 19.7° up.
        let (up, turned) = (19.7_f32.to_radians(), 0.5_f32.to_radians());
        let want = Vec3::new(
            10.0 * up.cos() * turned.cos(),
            -10.0 * up.cos() * turned.sin(),
            10.0 * up.sin(),
        );
        assert!(scan.points[0].distance(want) < 1e-4, "{sensor:?}: {}", scan.points[0]);
        assert_eq!(scan.rings.as_ref().unwrap()[0] as usize, layout.lasers - 1);
        let late_ns = scan.time_ns.unwrap() - (secs * 1_000_000_000 + 250_000_000);
        assert!(late_ns.abs() < 700_000, "{sensor:?}: {late_ns}");
        let times = scan.times.unwrap();
        assert!(times.iter().all(|t| (-1e-4..8e-4).contains(t)), "{sensor:?}");
    }
}

#[test]
fn a_return_that_is_told_twice_is_one() {
    for sensor in hesai() {
        let layout = Layout::of(sensor).unwrap();
        let mut packet = packet(sensor, 0, 20, 2_500, 0x39, 0);
        // But the first laser's second return is another one.
        packet[layout.block_at(1) + layout.block_head] ^= 1;
        let mut decoder = decoder(sensor);
        decoder.push(0, &packet).unwrap();
        let scan = decoder.finish().unwrap().scan;
        assert_eq!(scan.points.len(), layout.lasers * layout.blocks / 2 + 1, "{sensor:?}");
        assert_eq!(scan.dropped.no_return, 0);
    }
}

#[test]
fn packets_are_numbered() {
    let sensor = Sensor::Xt32;
    let layout = Layout::of(sensor).unwrap();
    let mut decoder = decoder(sensor);
    for number in [u32::MAX - 1, u32::MAX, 3, 2, 4, 1_000_000] {
        let mut packet = packet(sensor, 0, 20, 2_500, 0x37, number);
        packet[11] = 1;
        let at = layout.sequence_at(&packet).unwrap();
        packet[at..at + 4].copy_from_slice(&number.to_le_bytes());
        decoder.push(0, &packet).unwrap();
    }
    let counts = decoder.counts();
    // Of 0, 1 and 2, the last one came late; then the sensor was switched on again.
    assert_eq!((counts.packets, counts.lost, counts.late), (6, 2, 1));
}

#[test]
fn hostile_packets_and_dates_are_told() {
    for sensor in hesai() {
        let good = packet(sensor, 0, 20, 2_500, 0x37, 0);
        let layout = Layout::of(sensor).unwrap();
        let mut decoder = decoder(sensor);
        for length in 0..layout.tail.mode {
            let told = decoder.push(0, &good[..length]).err().map(|e| e.to_string());
            assert!(
                length == 512 || told.is_some_and(|told| told.contains("bytes")),
                "{sensor:?} {length}"
            );
        }
        let mut bad = good.clone();
        bad[layout.tail.mode] = 0x77;
        let told = decoder.push(0, &bad).unwrap_err().to_string();
        assert_eq!(told, "a packet has a return mode that is not known: 0x77");
        let mut undated = good;
        undated[layout.tail.date + 1] = 13;
        decoder.push(5_000, &undated).unwrap();
        assert!(decoder.notes().iter().any(|note| note.contains("impossible date")));
    }
    assert_eq!(date_secs([70, 1, 1, 0, 0, 1], 1900), Some(1));
    assert_eq!(date_secs([24, 2, 29, 12, 30, 15], 2000), Some(1_709_209_815));
    assert_eq!(date_secs([0, 0, 0x65, 0xE0, 0x7A, 0x17], 1900), Some(0x65E0_7A17));
    assert_eq!(date_secs([0; 6], 1900), None);
}

#[test]
fn calibrations_have_all_lasers_once() {
    let angles = |text: &str| parse_csv(text).map(|angles| angles.deg).map_err(|e| e.to_string());
    let want = Ok(vec![[1.5, -0.5], [-2.0, 3.25]]);
    assert_eq!(angles("Laser id,Elevation,Azimuth\n1,1.5,-0.5\n2,-2,3.25\n"), want);
    // Out of order, with Windows' line ends, a mark of UTF-8, further columns and a checksum at the end.
    assert_eq!(
        angles("\u{feff}EEFF,1,1\r\n2,-2,3.25,0\r\n1,1.5,-0.5,0\r\n\r\nab12cd"),
        want
    );
    for bad in [
        "",
        "1,2",
        "1,1,1\n1,1,1",
        "2,1,1",
        "1,91,0",
        "1,nan,0",
        "0,1,1",
        "1e9,1,1",
        "1,1,1\n2,x,1",
    ] {
        assert!(angles(bad).is_err(), "{bad}");
    }
    let told = Decoder::new(Sensor::Xt32, Any::parse(b"1,1,1").unwrap())
        .unwrap_err()
        .to_string();
    assert_eq!(told, "the calibration has 1 lasers, a xt32 has 32");
    for sensor in hesai() {
        match Decoder::new(sensor, Any::Nominal) {
            Ok(decoder) => {
                assert_eq!(decoder.model().unwrap().rings(), Layout::of(sensor).unwrap().lasers);
                assert!(decoder.notes()[0].contains("nominal"));
            }
            Err(told) => assert!(told.to_string().ends_with("needs its calibration, a CSV of angles")),
        }
    }
}
