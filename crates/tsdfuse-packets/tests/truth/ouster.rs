//! Ouster's captures against what the maker's SDK (ouster-sdk 1.0.1, `XYZLut` in the sensor's frame) makes of them.

use std::f64::consts::TAU;
use std::path::Path;

use md5::{Digest, Md5};
use tsdfuse::Scan;
use tsdfuse_packets::{Calibration, Decoder, Sensor, Sweep};

/// What the SDK gives of a frame, second returns that repeat the first left out.
struct Frame {
    first_ns: i64,
    returns: usize,
    /// Sums of the coordinates and of their magnitudes, metres.
    sum: [f64; 3],
    magnitude: [f64; 3],
    /// Sum of the times after the first column's, seconds, and of signal (or reflectivity where there is none).
    times: f64,
    intensity: f64,
    /// The first return.
    first: [f32; 3],
}

fn sweeps(capture: &str, metadata: &str) -> Option<(Decoder, Vec<Sweep>, Vec<tsdfuse::ImuSample>)> {
    let logs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs/ouster");
    if !logs.is_dir() {
        println!("skipped: no {}", logs.display());
        return None;
    }
    let metadata = std::fs::read(logs.join(metadata)).unwrap();
    let mut decoder = Decoder::new(Sensor::Ouster, Calibration::parse(&metadata).unwrap()).unwrap();
    let (mut sweeps, mut imu) = (Vec::new(), Vec::new());
    for (received_ns, payload) in datagrams(&std::fs::read(logs.join(capture)).unwrap()) {
        imu.extend(decoder.imu(received_ns, &payload));
        if payload.len() != 48 {
            assert_eq!(Sensor::recognise(&payload), Some(Sensor::Ouster));
        }
        sweeps.extend(decoder.push(received_ns, &payload).unwrap());
    }
    sweeps.extend(decoder.finish());
    Some((decoder, sweeps, imu))
}

/// The datagrams of a little-endian capture of whole Ethernet frames.
fn datagrams(capture: &[u8]) -> Vec<(i64, Vec<u8>)> {
    let mut datagrams = Vec::new();
    let mut rest = &capture[24..];
    while let [a, b, c, d, e, f, g, h, i, j, k, l, _, _, _, _, body @ ..] = rest {
        let [secs, micros, length] = [[*a, *b, *c, *d], [*e, *f, *g, *h], [*i, *j, *k, *l]].map(u32::from_le_bytes);
        let (frame, after) = body.split_at(length as usize);
        datagrams.push((
            i64::from(secs) * 1_000_000_000 + i64::from(micros) * 1000,
            frame[42..].to_vec(),
        ));
        rest = after;
    }
    datagrams
}

fn check(scan: &Scan, frame: &Frame) {
    assert_eq!((scan.time_ns, scan.points.len()), (Some(frame.first_ns), frame.returns));
    assert!(
        scan.points[0].distance(frame.first.into()) < 2e-5,
        "{} {:?}",
        scan.points[0],
        frame.first
    );
    let sum = |f: fn(f64) -> f64| {
        let points = scan.points.iter().map(|p| p.as_dvec3().to_array().map(f));
        points.fold([0.0; 3], |sum: [f64; 3], p| {
            [sum[0] + p[0], sum[1] + p[1], sum[2] + p[2]]
        })
    };
    for (found, told) in [(sum(|v| v), frame.sum), (sum(f64::abs), frame.magnitude)] {
        // A tenth of a millimetre in each return.
        let off = found
            .iter()
            .zip(told)
            .all(|(a, b)| (a - b).abs() < 1e-4 * frame.returns as f64);
        assert!(off, "{found:?} {told:?}");
    }
    let times: f64 = scan.times.as_ref().unwrap().iter().map(|&t| f64::from(t)).sum();
    assert!(
        (times - frame.times).abs() < 1e-6 * frame.returns as f64,
        "{times} {}",
        frame.times
    );
    let intensity: f64 = scan.intensities.as_ref().unwrap().iter().map(|&i| f64::from(i)).sum();
    assert_eq!(intensity, frame.intensity);
}

#[test]
fn dual_returns_are_as_in_the_sdk() {
    let name = "OS-0-32-U1_v2.2.0_1024x10";
    let Some((decoder, sweeps, imu)) = sweeps(&format!("{name}.pcap"), &format!("{name}.json")) else {
        return;
    };
    assert_eq!((sweeps.len(), sweeps[0].is_whole, decoder.counts().lost), (1, true, 0));
    check(
        &sweeps[0].scan,
        &Frame {
            first_ns: 515_816_892_860,
            returns: 21_631 + 172,
            sum: [-3_881.663 + 1_014.302, -24_364.463 - 2_080.092, 1_579.652 + 601.095],
            magnitude: [73_742.542 + 1_322.914, 86_738.812 + 2_601.268, 36_991.185 + 716.483],
            times: 1_103.038558 + 9.417565,
            intensity: 3_145_374.0 + 2_761.0,
            first: [-4.31185, -0.21703, 4.16135],
        },
    );
    assert_eq!((imu.len(), imu[0].time_ns), (10, 515_839_016_690));
    assert!((imu[0].acceleration.z - 1.014_404_296_875 * 9.80665).abs() < 1e-9);
    assert!((imu[0].angular_velocity.y - 0.663_757_324_218_75_f64.to_radians()).abs() < 1e-12);
    let model = decoder.model().unwrap();
    assert_eq!(
        (model.name.as_str(), model.rings(), model.columns),
        ("os0-32", 32, 1024)
    );
}

#[test]
fn low_data_rate_frames_are_as_in_the_sdk() {
    let Some((decoder, sweeps, imu)) = sweeps("OS-1-128_v2.3.0_1024x10_lb_n3.pcap", "OS-1-128_v2.3.0_1024x10.json")
    else {
        return;
    };
    let frame = |first_ns, returns, sum, magnitude, times, intensity, first| Frame {
        first_ns,
        returns,
        sum,
        magnitude,
        times,
        intensity,
        first,
    };
    let frames = [
        frame(
            991_587_364_520,
            107_647,
            [15_229.477, 205_214.687, 64_598.954],
            [1_081_754.911, 1_080_852.341, 272_779.355],
            5_451.723322,
            1_515_516.0,
            [-55.36007, -4.07394, 6.59451],
        ),
        frame(
            991_687_315_250,
            107_357,
            [12_101.628, 199_698.316, 63_377.943],
            [1_078_603.813, 1_079_590.989, 272_128.883],
            5_439.859637,
            1_511_825.0,
            [-55.45515, -4.08094, 6.60577],
        ),
        frame(
            991_787_323_080,
            107_532,
            [21_344.241, 196_677.704, 64_243.454],
            [1_084_872.323, 1_086_632.017, 273_520.156],
            5_453.182795,
            1_507_611.0,
            [-55.53438, -4.08677, 6.61516],
        ),
    ];
    assert_eq!((sweeps.len(), imu.len(), decoder.counts().lost), (3, 30, 0));
    for (sweep, frame) in sweeps.iter().zip(&frames) {
        assert!(sweep.is_whole);
        check(&sweep.scan, frame);
    }
}

#[test]
fn functional_safety_is_as_in_the_sdk() {
    let name = "OS-1-128_767798045_1024x10_20230712_120049";
    let Some((_, sweeps, imu)) = sweeps(&format!("{name}.pcap"), &format!("{name}.json")) else {
        return;
    };
    // Eight packets of a frame.
    assert_eq!(
        (sweeps.len(), sweeps[0].is_whole, sweeps[0].packets, imu.len()),
        (1, false, 8, 2)
    );
    check(
        &sweeps[0].scan,
        &Frame {
            first_ns: 647_839_983_424,
            returns: 16_373 + 1_089,
            sum: [-11_995.008 - 1_241.412, 3_172.011 + 293.35, 874.499 + 151.175],
            magnitude: [11_995.008 + 1_241.412, 3_241.722 + 294.749, 2_329.043 + 235.813],
            times: 101.69219 + 3.751155,
            intensity: 840_721.0 + 6_282.0,
            first: [-2.19119, 0.15968, 0.85208],
        },
    );
}

#[test]
fn legacy_packets_are_as_in_the_sdk() {
    let name = "OS-1-32-G_v2.1.1_1024x10";
    let Some((_, sweeps, _)) = sweeps(&format!("{name}.pcap"), &format!("{name}.json")) else {
        return;
    };
    check(
        &sweeps[0].scan,
        &Frame {
            first_ns: 3_577_133_606_620,
            returns: 27_310,
            sum: [27_528.301, 24_873.943, -1_977.381],
            magnitude: [339_797.359, 280_422.521, 32_551.076],
            times: 1_393.489915,
            intensity: 2_589_590.0,
            first: [-12.60465, -0.92889, 2.89249],
        },
    );
}

/// Metadata of which little is left: as the first firmware wrote them.
#[test]
fn little_metadata_are_completed_as_in_the_sdk() {
    let Some((decoder, sweeps, imu)) = sweeps("OS-1-64_1024x10_fw20.pcap", "OS-1-64_sensor_config_reduced.json") else {
        return;
    };
    check(
        &sweeps[0].scan,
        &Frame {
            first_ns: 278_211_490_950,
            returns: 16_749,
            sum: [3_203.206, 20_918.688, 7_149.68],
            magnitude: [48_297.869, 32_846.836, 10_240.307],
            times: 730.635357,
            intensity: 3_279_754.0,
            first: [-1.80942, 0.09796, 0.56797],
        },
    );
    assert_eq!((imu.len(), decoder.notes().len()), (11, 1));
    assert_eq!(decoder.model().unwrap().name, "ouster-64");
}

/// The range image of a frame, millimetres, from its points: their beams are followed back.
fn range_image(scan: &Scan, metadata: &serde_json::Value) -> Vec<u32> {
    let numbers = |key: &str| -> Vec<f64> {
        let list = metadata[key].as_array().unwrap();
        list.iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let (azimuths, elevations) = (numbers("beam_azimuth_angles"), numbers("beam_altitude_angles"));
    let out_mm = metadata["lidar_origin_to_beam_origin_mm"].as_f64().unwrap();
    // The lidar frame looks backwards, 36.18 mm above the sensor's.
    let up_mm = numbers("lidar_to_sensor_transform")[11];
    let (rows, columns) = (elevations.len(), 1024);
    let mut by_height: Vec<usize> = (0..rows).collect();
    by_height.sort_by(|&a, &b| elevations[a].total_cmp(&elevations[b]));
    let mut image = vec![0; rows * columns];
    for (point, &ring) in scan.points.iter().zip(scan.rings.as_ref().unwrap()) {
        let row = by_height[usize::from(ring)];
        let point = point.as_dvec3() * 1e3;
        let (x, y, z) = (-point.x, -point.y, point.z - up_mm);
        let mut turn = y.atan2(x);
        for _ in 0..9 {
            turn = (y - out_mm * turn.sin()).atan2(x - out_mm * turn.cos()) + azimuths[row].to_radians();
        }
        let range = (x - out_mm * turn.cos()).hypot(y - out_mm * turn.sin()).hypot(z) + out_mm;
        let column = (-turn / TAU * columns as f64).round().rem_euclid(columns as f64) as usize % columns;
        image[row * columns + column] = range.round() as u32;
    }
    image
}

/// The maker's own decoder left digests of each field beside the captures: no pixel is another. (Of two returns, it is not seen which one
/// a lone return was, so the other capture's digests cannot be made from points.)
#[test]
fn the_range_image_has_the_digest_of_the_maker() {
    let name = "OS-1-32-G_v2.1.1_1024x10";
    let Some((_, sweeps, _)) = sweeps(&format!("{name}.pcap"), &format!("{name}.json")) else {
        return;
    };
    let json = |name: &str| -> serde_json::Value {
        let logs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs/ouster");
        serde_json::from_slice(&std::fs::read(logs.join(name)).unwrap()).unwrap()
    };
    let told = &json(&format!("{name}_digest.json"))["scans"][0]["RANGE"];
    let digest = |image: &[u32]| -> String {
        let bytes: Vec<u8> = image.iter().flat_map(|mm| mm.to_le_bytes()).collect();
        Md5::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
    };
    let mut image = range_image(&sweeps[0].scan, &json(&format!("{name}.json")));
    assert_eq!(digest(&image), told.as_str().unwrap());
    // One pixel a millimetre off is another image.
    image[17_000] += 1;
    assert!(digest(&image) != told.as_str().unwrap());
}
