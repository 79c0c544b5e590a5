use tsdfuse::glam::DVec3;

use super::*;
use crate::{Calibration as Any, Decoder};

/// A packet of a VLP-16: all blocks from an azimuth, one return of the same range in each place.
pub(crate) fn vlp16(azimuth: u16, step: u16, range: u16, micros: u32) -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12 {
        packet.extend([0xFF, 0xEE]);
        packet.extend(((azimuth + block * step) % TURN).to_le_bytes());
        (0..32).for_each(|_| packet.extend([range as u8, (range >> 8) as u8, 9]));
    }
    packet.extend(micros.to_le_bytes());
    packet.extend([0x37, 0x22]);
    packet
}

#[test]
fn clocks_that_tell_the_time_in_the_hour_are_completed() {
    let hour = 3_600_000_000_000_i64;
    let at = |hours: i64, micros: i64| hours * hour + micros * 1000;
    assert_eq!(in_hour(5, at(400_000, 7)), at(400_000, 5));
    assert_eq!(in_hour(3_599_999_999, at(400_000, 7)), at(399_999, 3_599_999_999));
    assert_eq!(in_hour(1, at(400_000, 3_599_999_000)), at(400_001, 1));
    // Counts that no hour has, and times at the ends, are bearable.
    for near in [i64::MIN, -1, 0, i64::MAX] {
        in_hour(u32::MAX, near);
    }
}

#[test]
fn a_laser_looks_where_the_manual_says() {
    let mut decoder = Decoder::new(Sensor::Vlp16, Any::Nominal).unwrap();
    // Ahead, 10 m; the first laser looks 15° down, the second 1° up and fires 2.304 µs later.
    decoder.push(0, &vlp16(0, 40, 5000, 0)).unwrap();
    let sweep = decoder.finish().unwrap();
    assert_eq!(
        (sweep.scan.points.len(), sweep.packets, sweep.is_whole),
        (384, 1, false)
    );
    let (first, second) = (sweep.scan.points[0], sweep.scan.points[1]);
    let down = 15_f32.to_radians();
    assert!(
        first.distance(Vec3::new(10.0 * down.cos(), 0.0, -10.0 * down.sin())) < 1e-5,
        "{first}"
    );
    assert!(second.z > 0.0 && second.y < 0.0, "{second}: it turns to the right");
    assert_eq!(sweep.scan.rings.as_deref().map(|r| &r[..3]), Some(&[0, 8, 1][..]));
    let times = sweep.scan.times.unwrap();
    assert!((times[1] - 2.304e-6).abs() < 1e-9 && (times[16] - 55.296e-6).abs() < 1e-9);
    assert!((times[32] - 110.592e-6).abs() < 1e-9);
}

#[test]
fn sweeps_end_at_zero_and_lost_packets_are_counted() {
    let mut decoder = Decoder::new(Sensor::Vlp16, Any::Nominal).unwrap();
    let mut sweeps = Vec::new();
    for i in 0..200_u32 {
        // Packets 50 to 54 are lost, and one comes late.
        let i = if i == 120 { 118 } else { i };
        if !(50..55).contains(&i) {
            let packet = vlp16((i * 480 % 36_000) as u16, 40, 5000, i * 1327);
            sweeps.extend(decoder.push(i64::from(i) * 1_327_000, &packet).unwrap());
        }
    }
    assert_eq!(sweeps.len(), 2);
    let counts = decoder.counts();
    assert_eq!((counts.packets, counts.late), (195, 1));
    assert_eq!(counts.lost, 5);
    assert_eq!(sweeps.iter().map(|s| s.is_whole).collect::<Vec<_>>(), [false, true]);
    assert!((decoder.model().unwrap().columns as i32 - 1800).abs() < 4);
    let begins: Vec<_> = sweeps.iter().map(|s| s.scan.time_ns.unwrap()).collect();
    assert_eq!(begins[1], 75 * 1_327_000);
}

#[test]
fn what_is_no_packet_is_told_in_a_sentence() {
    let mut decoder = Decoder::new(Sensor::Vlp16, Any::Nominal).unwrap();
    let told = |decoder: &mut Decoder, packet: &[u8]| decoder.push(0, packet).unwrap_err().to_string();
    assert_eq!(
        told(&mut decoder, &[0; 7]),
        "a packet of 7 bytes is not a Velodyne's, which has 1206"
    );
    assert_eq!(
        told(&mut decoder, &[0; 1206]),
        "a packet has a block that is no vlp16's"
    );
    assert!(decoder.push(0, &[0; 512]).unwrap().is_none(), "GPS");
    assert!(decoder.finish().is_none());
    let told = Decoder::new(Sensor::Hdl64e, Any::Nominal).unwrap_err().to_string();
    assert_eq!(told, "an HDL-64E needs its calibration, an XML or a YAML");
}

/// A packet with a sentence, sent at these microseconds in the hour.
fn position(micros: u32, sentence: &str) -> Vec<u8> {
    let mut packet = vec![0; POSITION];
    packet[SENT..SENT + 4].copy_from_slice(&micros.to_le_bytes());
    packet[SENTENCE..SENTENCE + sentence.len()].copy_from_slice(sentence.as_bytes());
    packet
}

/// What a receiver tells at these seconds of 08:18.
fn rmc(secs: f64, latitude: &str, status: &str) -> String {
    let text = format!("GPRMC,0818{secs:05.2},{status},{latitude},N,00224.0,W,0.0,0.0,210116,,");
    let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${text}*{sum:02X}\r\n")
}

#[test]
fn a_place_is_told_once_at_the_time_at_which_it_was_measured() {
    let mut decoder = Decoder::new(Sensor::Vlp16, Any::Nominal).unwrap();
    let hour_ns = 400_000 * HOUR_NS + 8 * HOUR_NS;
    let at = |secs: f64| (1_080.0 + secs) * 1e6;
    let mut told = |secs: f64, sentence: &str| {
        let received_ns = hour_ns + at(secs) as i64 * 1000 + 5_000_000;
        decoder
            .position(received_ns, &position(at(secs) as u32, sentence))
            .unwrap()
    };
    let fix = |secs: f64, latitude_deg: f64| Position::Fix {
        time_ns: hour_ns + at(secs) as i64 * 1000,
        latitude_deg,
        longitude_deg: -2.4,
    };
    assert_eq!(told(2.3, &rmc(2.0, "3630.0", "A")), fix(2.0, 36.5));
    assert_eq!(told(2.9, &rmc(2.0, "3630.0", "A")), Position::Repeated);
    assert_eq!(told(3.3, &rmc(3.0, "3645.0", "A")), fix(3.0, 36.75));
    // No fix, a damaged sentence, and none.
    assert_eq!(told(4.3, &rmc(4.0, "3645.0", "V")), Position::Void);
    assert_eq!(told(4.4, &rmc(4.0, "3645.0", "V")), Position::Repeated);
    assert_eq!(
        told(5.3, &rmc(5.0, "3645.0", "A").replace("3645", "3644")),
        Position::Void
    );
    assert_eq!(told(6.3, ""), Position::Void);
    assert_eq!(told(6.4, ""), Position::Repeated);
    assert!(decoder.position(0, &[0; 511]).is_none() && decoder.position(0, &vlp16(0, 40, 5000, 0)).is_none());
    // The sensor's clock counts from somewhere else, as without pulses of the receiver.
    let mut decoder = Decoder::new(Sensor::Vlp16, Any::Nominal).unwrap();
    let mut told = |micros: u32, sentence: &str| decoder.position(hour_ns, &position(micros, sentence)).unwrap();
    assert_eq!(told(100, &rmc(2.0, "3630.0", "A")), Position::Repeated);
    let Position::Fix { time_ns, .. } = told(900_000, &rmc(3.0, "3630.0", "A")) else {
        panic!("a new place");
    };
    assert_eq!(time_ns, hour_ns + 900_000_000);
}

/// The position packet of an HDL-32E that is turned and accelerated so (rad/s, m/s², sensor frame), written side by side: each side's gyroscope counts
/// clockwise about the cross product of its accelerometers' axes.
fn moved(micros: u32, rates: DVec3, force: DVec3, temperature: i16) -> Vec<u8> {
    let sides = [(DVec3::Z, DVec3::Y), (DVec3::Z, -DVec3::X), (-DVec3::Y, -DVec3::X)];
    let mut packet = vec![0; 14];
    for (x, y) in sides {
        let rate = -rates.dot(x.cross(y)).to_degrees() / 0.097_66;
        let forces = [x, y].map(|axis| force.dot(axis) / 9.806_65 / 0.001_221);
        let counts = [rate, f64::from(temperature), forces[0], forces[1]];
        // What is above the twelve bits does not count.
        packet.extend(
            counts
                .map(|count| (count.round() as i16 & 0xFFF) as u16 | 0xA000)
                .map(u16::to_le_bytes)
                .concat(),
        );
    }
    packet.resize(198, 0);
    packet.extend(micros.to_le_bytes());
    packet.resize(512, 0);
    packet
}

#[test]
fn an_hdl_32e_tells_how_it_is_turned_and_accelerated() {
    let decoder = Decoder::new(Sensor::Hdl32e, Any::Nominal).unwrap();
    // A quarter of a second before the hour is full, received after it.
    let hour_ns = 400_000 * HOUR_NS;
    let (rates, force) = (DVec3::new(0.3, -0.7, 1.1), DVec3::new(1.5, -2.5, 9.5));
    let packet = moved(3_599_750_000, rates, force, -300);
    let [sample] = decoder.imu(hour_ns + 1_000_000, &packet)[..] else {
        panic!("one sample");
    };
    assert_eq!((sample.time_ns, sample.orientation), (hour_ns - 250_000_000, None));
    // Half a count, which the mean of two accelerometers does not make worse.
    assert!(
        sample
            .angular_velocity
            .abs_diff_eq(rates, 0.5001 * 0.097_66_f64.to_radians()),
        "{sample:?}"
    );
    assert!(
        sample.acceleration.abs_diff_eq(force, 0.5001 * 0.001_221 * 9.806_65),
        "{sample:?}"
    );
    // The largest counts there are, of either sign.
    for sign in [1.0, -1.0] {
        let most = (2047.0 * 0.097_66_f64).to_radians() * sign;
        let [sample] = decoder.imu(0, &moved(0, DVec3::splat(most), DVec3::ZERO, 0))[..] else {
            panic!("one sample");
        };
        assert!(
            sample.angular_velocity.abs_diff_eq(DVec3::splat(most), 1e-9),
            "{sample:?}"
        );
    }
    // Other sensors have none there, and a packet of another length is another one.
    assert!(decoder.imu(0, &position(5, "")).is_empty() && decoder.imu(0, &packet[..511]).is_empty());
    let vlp16 = Decoder::new(Sensor::Vlp16, Any::Nominal).unwrap();
    assert!(vlp16.imu(0, &packet).is_empty());
}

#[test]
fn calibrations_are_read_as_blocks_and_in_braces_and_as_xml() {
    let yaml = "lasers:\n- dist_correction: 0.5\n  laser_id: 1\n  rot_correction: 0.1\n  vert_correction: -0.25\n\
                - {laser_id: 0, vert_correction: 0.125, rot_correction: 1.0e-2} # a comment\nnum_lasers: 2\ndistance_resolution: 0.004\n";
    let read = parse_yaml(yaml).unwrap();
    assert_eq!(read.range_unit_m, Some(0.004));
    assert_eq!(
        (read.lasers[0].elevation_rad, read.lasers[0].azimuth_rad),
        (0.125, 0.01)
    );
    assert_eq!(
        (read.lasers[1].elevation_rad, read.lasers[1].range_offset_m),
        (-0.25, 0.5)
    );
    let px = |id: usize, deg: f64| {
        format!(
            "<px class_id=\"1\"><id_>{id}</id_><rotCorrection_>-4.5</rotCorrection_><vertCorrection_>{deg}</vertCorrection_><distCorrection_>129</distCorrection_></px>"
        )
    };
    let lasers: String = (0..16).map(|id| px(id, id as f64 - 8.5)).collect();
    let read = parse_xml(&format!("<?xml?><DB><distLSB_>0.2</distLSB_>{lasers}</DB>")).unwrap();
    assert_eq!((read.lasers.len(), read.range_unit_m), (16, Some(0.002)));
    assert!((read.lasers[3].elevation_rad + 5.5_f64.to_radians()).abs() < 1e-12);
    assert!((read.lasers[3].range_offset_m - 1.29).abs() < 1e-12);
    for bad in [
        "lasers:\n- laser_id: 1\n",
        "lasers:\n- {laser_id: 0, vert_correction: nan}",
        "lasers:\n- {laser_id: 0, vert_correction: 2}",
        "lasers:",
    ] {
        assert!(parse_yaml(bad).is_err(), "{bad}");
    }
    assert!(parse_xml("<px><id_>x</id_></px>").is_err());
}

/// A correction that was measured at two distances is what was measured there.
#[test]
fn two_point_corrections_hold_where_they_were_measured() {
    let laser = Laser {
        range_offset_m: 1.2,
        near_range_offset_m: Some([1.1, 1.3]),
        ..Laser::default()
    };
    let beam = Beam {
        ring: 0,
        laser,
        elevation_sin_cos: (0.0, 1.0),
    };
    // Ahead at 25.04 m after correction, and 1.93 m as it seems to be.
    assert!((beam.point(25.04 - 1.2, 0.0).x - 25.04).abs() < 1e-5);
    assert!((beam.point(1.93 - 1.2, 0.0).x - (1.93 + 0.1)).abs() < 1e-5);
}
