//! Feeds each parser with arbitrary bytes, for the targets in `fuzz/`. Not part of the library's interface.

use crate::{Calibration, Decoder, Position, Sensor, position};

/// A calibration, of whatever kind it looks like.
pub fn calibration(bytes: &[u8]) {
    if let Ok(calibration) = Calibration::parse(bytes) {
        for sensor in Sensor::ALL {
            if let Ok(decoder) = Decoder::new(sensor, calibration.clone()) {
                let _ = decoder.model();
            }
        }
    }
}

/// A decoder of each sensor; of Ouster's, one for each layout of packets that are as long as the bytes may be.
fn decoders() -> impl Iterator<Item = Decoder> {
    let angles = vec![[0.0, 0.0]; 128];
    let hesai = Calibration::Hesai(crate::hesai::Angles { deg: angles });
    let nominal = Sensor::ALL.map(|sensor| (sensor, Calibration::Nominal));
    let ouster = [
        "LEGACY",
        "RNG19_RFL8_SIG16_NIR16_DUAL",
        "RNG15_RFL8_NIR8",
        "FUSA_RNG15_RFL8_NIR8_DUAL",
    ]
    .map(|profile| {
        let zeros = "0,".repeat(15) + "0";
        let json = format!(
            "{{\"beam_altitude_angles\":[{zeros}],\"beam_azimuth_angles\":[{zeros}],\"lidar_mode\":\"1024x10\",\
             \"udp_profile_imu\":\"ACCEL32_GYRO32_NMEA\",\"imu_measurements_per_packet\":8,\"udp_profile_lidar\":\"{profile}\"}}"
        );
        (Sensor::Ouster, Calibration::parse(json.as_bytes()).unwrap_or_default())
    });
    let more = [Sensor::Qt128, Sensor::Pandar128].map(|sensor| (sensor, hesai.clone()));
    let all = nominal.into_iter().chain(ouster).chain(more);
    all.filter_map(|(sensor, calibration)| Decoder::new(sensor, calibration).ok())
}

/// A packet of each sensor, as it is and as long as that sensor's; columns agree in length, and there is no more in a sweep than
/// was in its packets.
///
/// # Panics
/// If not.
pub fn packets(bytes: &[u8]) {
    let _ = Sensor::recognise(bytes);
    // With the checksum that belongs to it.
    let sum = bytes.iter().fold(0, |sum, byte| sum ^ byte);
    let _ = position::parse(&[bytes, format!("*{sum:02X}").as_bytes()].concat());
    for mut decoder in decoders() {
        let mut sweeps = Vec::new();
        for received_ns in [0, 1_700_000_000_000_000_000, i64::MAX, i64::MIN] {
            if let Some(Position::Fix { latitude_deg, .. }) = decoder.position(received_ns, bytes) {
                assert!(latitude_deg.abs() <= 90.0, "a place on the earth");
            }
            sweeps.extend(decoder.push(received_ns, bytes).ok().flatten());
        }
        sweeps.extend(decoder.finish());
        for received_ns in [0, i64::MAX, i64::MIN] {
            let samples = decoder.imu(received_ns, bytes);
            assert!(samples.len() <= bytes.len() / 36, "no more than was there");
        }
        for sweep in sweeps {
            assert!(sweep.scan.check().is_ok(), "columns fit together");
            assert!(sweep.scan.points.len() <= 4 * bytes.len(), "no more than was there");
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Lengths that packets have, so that more than their length is looked at.
    fn lengths() -> impl Strategy<Value = usize> {
        prop::sample::select(vec![
            0, 48, 512, 568, 820, 861, 893, 1072, 1080, 1087, 1127, 1198, 1206, 1262, 3392, 6464,
        ])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn any_packets_are_bearable(
            length in lengths(),
            seed in any::<u8>(),
            marks in prop::sample::select(vec![[0xFF, 0xEE], [0xEE, 0xFF], [0, 0]]),
            spots in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..40),
            version in any::<[u8; 2]>(),
        ) {
            let mut bytes = vec![seed; length];
            if length > 12 {
                for block in 0..length / 100 {
                    bytes[block * 100..block * 100 + 2].copy_from_slice(&marks);
                }
                bytes[2..4].copy_from_slice(&version.map(|v| v % 8));
                for (at, value) in spots {
                    let at = at.index(length);
                    bytes[at] = value;
                }
            }
            packets(&bytes);
        }

        #[test]
        fn any_calibration_is_bearable(text in "[ \\-0-9a-z_:{},\n.<>]{0,200}", begin in prop::sample::select(vec!["", "lasers:\n", "<px", "{\"", "1,2,3\n"])) {
            calibration(format!("{begin}{text}").as_bytes());
        }
    }
}
