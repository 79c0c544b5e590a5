use tsdfuse::glam::DVec3;

use super::*;
use crate::{Calibration, Decoder};

/// Metadata of a small sensor: 16 rows, 64 columns, 16 a packet.
fn metadata(profile: &str, more: &str) -> String {
    let beams: Vec<String> = (0..16).map(|row| (15 - 2 * row).to_string()).collect();
    let beams = beams.join(",");
    let azimuths = ["0"; 16].join(",");
    format!(
        "{{\"beam_altitude_angles\":[{beams}],\"beam_azimuth_angles\":[{azimuths}],\"lidar_origin_to_beam_origin_mm\":10,\
         \"prod_line\":\"OS-1-16\",\"prod_sn\":\"77\",\"lidar_mode\":\"64x10\",{more}\
         \"data_format\":{{\"columns_per_frame\":64,\"columns_per_packet\":16,\"pixels_per_column\":16,\"column_window\":[0,63],\
         \"udp_profile_lidar\":\"{profile}\"}}}}"
    )
}

fn decoder(profile: &str) -> Decoder {
    Decoder::new(
        Sensor::Ouster,
        Calibration::parse(metadata(profile, "").as_bytes()).unwrap(),
    )
    .unwrap()
}

/// A packet of one return in each pixel.
fn packet(frame: u16, first: u16, range: u16) -> Vec<u8> {
    let mut bytes = vec![0; 32];
    bytes[0] = 1;
    bytes[2..4].copy_from_slice(&frame.to_le_bytes());
    bytes[7] = 77;
    for column in first..first + 16 {
        let time_ns = 1_000_000 * (64 * u64::from(frame) + u64::from(column));
        bytes.extend(time_ns.to_le_bytes());
        bytes.extend(column.to_le_bytes());
        bytes.extend([1, 0]);
        (0..16).for_each(|_| bytes.extend([range as u8, (range >> 8) as u8, 0, 0, 9, 0, 7, 0, 0, 0, 0, 0]));
    }
    bytes.extend([0; 32]);
    bytes
}

const FINE: &str = "RNG19_RFL8_SIG16_NIR16";

#[test]
fn frames_become_sweeps_and_late_or_lost_packets_are_counted() {
    let mut decoder = decoder(FINE);
    let mut sweeps = Vec::new();
    // The third packet of frame 65535 comes late, the second of frame 0 never, the last of frame 0 after frame 1 began.
    for (frame, first) in [
        (65_535, 0),
        (65_535, 16),
        (65_535, 48),
        (65_535, 32),
        (0, 0),
        (0, 32),
        (1, 0),
        (0, 48),
        (1, 16),
        (1, 32),
        (1, 48),
    ] {
        sweeps.extend(decoder.push(0, &packet(frame, first, 1000)).unwrap());
    }
    sweeps.extend(decoder.finish());
    let found: Vec<_> = sweeps
        .iter()
        .map(|s| (s.packets, s.is_whole, s.scan.points.len()))
        .collect();
    assert_eq!(found, [(4, true, 1024), (2, false, 512), (4, true, 1024)]);
    let counts = decoder.counts();
    assert_eq!((counts.packets, counts.late, counts.lost), (11, 2, 1));
}

#[test]
fn a_return_lies_on_its_beam() {
    let mut decoder = decoder(FINE);
    decoder.push(0, &packet(3, 16, 2010)).unwrap();
    let scan = decoder.finish().unwrap().scan;
    // Column 16 of 64: a quarter turn to the right of the lidar's x, which looks backwards. 15° up, from 10 mm off the axis.
    let (flat, up) = (
        2.0 * 15_f32.to_radians().cos() + 0.01,
        2.0 * 15_f32.to_radians().sin() + 0.03618,
    );
    let first = scan.points[0];
    assert!(
        first.distance(tsdfuse::glam::Vec3::new(0.0, flat, up)) < 1e-6,
        "{first}"
    );
    assert_eq!((scan.rings.unwrap()[0], scan.intensities.unwrap()[0]), (15, 7.0));
    assert_eq!(scan.time_ns, Some(1_000_000 * (64 * 3 + 16)));
}

#[test]
fn packets_are_matched_to_metadata_by_length_and_serial_number() {
    let parsed = |text: &str| Metadata::parse(text).unwrap();
    let ours = parsed(&metadata(FINE, ""));
    let other = parsed(&metadata(FINE, "").replace("\"77\"", "\"78\""));
    let packet = packet(0, 0, 1);
    assert!(ours.fits(&packet) && !other.fits(&packet) && !ours.fits(&packet[1..]));
    assert_eq!(ours.name(), "os1-16");
    // Where the packet does not tell.
    let mut silent = packet;
    silent[7] = 0;
    assert!(other.fits(&silent));
}

#[test]
fn what_is_wrong_is_told() {
    let told = |text: &str| Metadata::parse(text).unwrap_err().to_string();
    assert!(told("{").starts_with("the metadata are no JSON"));
    assert_eq!(told("{}"), "the metadata have no beam_altitude_angles");
    let good = metadata(FINE, "");
    assert!(told(&good.replace("_frame\":64", "_frame\":99999999")).contains("columns in a frame"));
    assert!(
        told(&good.replace("\"columns_per_packet\":16", "\"columns_per_packet\":0")).contains("columns in a frame")
    );
    assert!(told(&good.replace("[0,63]", "[0,64]")).contains("column_window"));
    assert!(told(&metadata(FINE, "\"lidar_to_sensor_transform\":[1,2],")).contains("4 x 4"));
    assert!(
        told(&metadata(
            FINE,
            "\"lidar_to_sensor_transform\":[0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0],"
        ))
        .contains("no motion")
    );
    let unknown = Calibration::parse(metadata("RNG99", "").as_bytes()).unwrap();
    let told = Decoder::new(Sensor::Ouster, unknown).unwrap_err().to_string();
    assert_eq!(told, "the metadata name a profile that is not known: RNG99");
    let told = decoder(FINE).push(0, &[1; 50]).unwrap_err().to_string();
    assert_eq!(
        told,
        "a packet of 50 bytes is not of this sensor, whose have 3328 (profile RNG19_RFL8_SIG16_NIR16)"
    );
    let told = Decoder::new(Sensor::Ouster, Calibration::Nominal)
        .unwrap_err()
        .to_string();
    assert!(told.contains("needs its metadata"));
}

/// A view into a sector: only some columns are sent, across column 0.
#[test]
fn a_window_is_whole_when_all_of_it_came() {
    let text = metadata(FINE, "").replace("[0,63]", "[48,15]");
    let mut decoder = Decoder::new(Sensor::Ouster, Calibration::parse(text.as_bytes()).unwrap()).unwrap();
    let mut sweeps = Vec::new();
    for frame in 0..3 {
        for first in [48, 0] {
            sweeps.extend(decoder.push(0, &packet(frame, first, 1000)).unwrap());
        }
    }
    assert!(sweeps.len() == 2 && sweeps.iter().all(|sweep| sweep.is_whole && sweep.turn == 0.5));
    assert_eq!(decoder.counts().lost, 0);
}

/// The inertial measurement unit's newer packets: eight samples, each with a time and a status, in m/s² and rad/s.
#[test]
fn newer_packets_of_the_imu_hold_many_samples() {
    let more = "\"udp_profile_imu\":\"ACCEL32_GYRO32_NMEA\",\"imu_measurements_per_packet\":8,\
                \"imu_to_sensor_transform\":[0,-1,0,0, 1,0,0,0, 0,0,1,0, 0,0,0,1],";
    let calibration = Calibration::parse(metadata(FINE, more).as_bytes()).unwrap();
    let mut decoder = Decoder::new(Sensor::Ouster, calibration).unwrap();
    let mut packet = vec![0; 32 + 100];
    packet[0] = 2;
    for i in 0..8_u64 {
        packet.extend((1_000_000_000 + i * 1_250_000).to_le_bytes());
        // The sixth was not measured.
        packet.extend([0, 0, u8::from(i != 5), 0]);
        let numbers = [0.5, 0.0, 9.806_65, 0.25 * i as f32, 0.0, 0.0];
        packet.extend(numbers.iter().flat_map(|v: &f32| v.to_le_bytes()));
    }
    packet.extend([0; 32]);
    let samples = decoder.imu(0, &packet);
    assert_eq!(samples.len(), 7);
    assert_eq!(samples[6].time_ns, 1_008_750_000);
    let turned = DVec3::new(0.0, 0.5, f64::from(9.806_65_f32));
    assert!(
        samples
            .iter()
            .all(|sample| sample.acceleration.distance(turned) < 1e-12),
        "{samples:?}"
    );
    assert!(samples[6].angular_velocity.distance(DVec3::new(0.0, 1.75, 0.0)) < 1e-12);
    // It holds no returns, and neither do packets of zones.
    assert!(decoder.push(0, &packet).unwrap().is_none());
    assert_eq!(decoder.counts().packets, 0);
    assert!(decoder.imu(0, &packet[1..]).is_empty() && self::decoder(FINE).imu(0, &packet).is_empty());
    assert!(decoder.imu(0, &[0; 48]).is_empty());
}

/// Headers for functional safety count frames with 32 bits elsewhere, in whatever profile.
#[test]
fn headers_for_functional_safety_are_read_in_all_profiles() {
    let calibration = Calibration::parse(metadata(FINE, "\"header_type\":\"FUSA\",").as_bytes()).unwrap();
    let mut decoder = Decoder::new(Sensor::Ouster, calibration).unwrap();
    let mut sweeps = 0;
    for frame in [70_000_u32, 70_000, 70_001, 70_001] {
        let mut packet = packet(0, 0, 1000);
        packet[2..12].fill(0);
        packet[4..8].copy_from_slice(&frame.to_le_bytes());
        packet[11] = 77;
        sweeps += usize::from(decoder.push(0, &packet).unwrap().is_some());
    }
    assert_eq!(sweeps, 1);
}

#[test]
fn colours_beside_second_returns_are_passed_over() {
    let mut decoder = decoder("RNG19_RFL8_SIG16_NIR16_RGB16_DUAL");
    let mut bytes = packet(0, 0, 0);
    bytes.truncate(32);
    for column in 0..16_u8 {
        bytes.extend([0; 8]);
        bytes.extend([column, 0, 1, 0]);
        // Ranges 1 m and 2 m, their reflectivities and signals, then near infrared, red, green, blue.
        let pixel = [232, 3, 0, 1, 208, 7, 0, 2, 5, 0, 6, 0, 9, 9, 9, 9, 9, 9, 9, 9];
        (0..16).for_each(|_| bytes.extend(pixel));
    }
    bytes.extend([0; 32]);
    decoder.push(0, &bytes).unwrap();
    let scan = decoder.finish().unwrap().scan;
    assert_eq!(scan.points.len(), 2 * 16 * 16);
    assert_eq!(scan.intensities.unwrap()[..2], [5.0, 6.0]);
    let off = Calibration::parse(metadata("OFF", "").as_bytes()).unwrap();
    let told = Decoder::new(Sensor::Ouster, off).unwrap_err().to_string();
    assert!(told.contains("sends no returns"), "{told}");
}
