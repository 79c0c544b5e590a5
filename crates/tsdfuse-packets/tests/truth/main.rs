//! Decoded points against those of the drivers of these sensors (nebula's), on recordings of real ones.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // the setting for tests does not reach their helpers

mod bag;
mod ouster;

use std::path::{Path, PathBuf};

use tsdfuse::Scan;
use tsdfuse::glam::{DVec3, Quat, Vec3};
use tsdfuse_packets::{Calibration, Decoder, Sensor, Sweep};

/// The recordings, where they are.
fn logs() -> Option<PathBuf> {
    let logs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs/nebula");
    if !logs.is_dir() {
        println!("skipped: no {}", logs.display());
        return None;
    }
    Some(logs)
}

fn file(folder: &Path, extension: &str) -> PathBuf {
    let mut files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files
        .find(|path| path.extension().is_some_and(|e| e == extension))
        .unwrap()
}

/// The points of a PCD.
fn truth(path: &Path) -> Vec<[f32; 3]> {
    let float = |b: &[u8], at: usize| f32::from_le_bytes(b[at..at + 4].try_into().unwrap());
    rows(path)
        .iter()
        .map(|b| [float(b, 0), float(b, 4), float(b, 8)])
        .collect()
}

/// The bytes of each point of a PCD.
fn rows(path: &Path) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(path).unwrap();
    let mark = b"DATA binary\n";
    let begin = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
    let header = String::from_utf8_lossy(&bytes[..begin]).into_owned();
    let sizes = header.lines().find_map(|line| line.strip_prefix("SIZE ")).unwrap();
    let stride = sizes.split(' ').map(|n| n.parse::<usize>().unwrap()).sum();
    bytes[begin..].chunks_exact(stride).map(<[u8]>::to_vec).collect()
}

struct Recording {
    sweeps: Vec<Sweep>,
    decoder: Decoder,
    truth: Vec<[f32; 3]>,
}

fn recording(name: &str, sensor: Sensor, calibration: &str) -> Option<Recording> {
    let logs = logs()?;
    let calibration = std::fs::read(logs.join("calibration").join(calibration)).unwrap();
    let mut decoder = Decoder::new(sensor, Calibration::parse(&calibration).unwrap()).unwrap();
    let packets = bag::packets(&std::fs::read(file(&logs.join(name), "db3")).unwrap());
    assert!(packets.len() > 300);
    let mut sweeps = Vec::new();
    for (received_ns, payload) in &packets {
        assert_eq!(Sensor::recognise(payload), Some(sensor));
        sweeps.extend(decoder.push(*received_ns, payload).unwrap());
    }
    sweeps.extend(decoder.finish());
    let truth = truth(&file(&logs.join(name), "pcd"));
    Some(Recording { sweeps, decoder, truth })
}

/// How many of the true points have a decoded one within 1 mm of range and 0.01°.
fn found(truth: &[[f32; 3]], sweeps: &[Sweep]) -> usize {
    use std::collections::HashMap;
    // By cells of direction and range, a few times as wide as the tolerance.
    let key = |[x, y, z]: [f32; 3]| {
        let range = (x * x + y * y + z * z).sqrt();
        [
            y.atan2(x).to_degrees() / 0.05,
            (z / range).asin().to_degrees() / 0.05,
            range / 0.005,
        ]
        .map(|v| v.floor() as i32)
    };
    let mut cells: HashMap<[i32; 3], Vec<[f32; 3]>> = HashMap::new();
    for point in sweeps.iter().flat_map(|sweep| &sweep.scan.points) {
        cells.entry(key(point.to_array())).or_default().push(point.to_array());
    }
    let is_found = |point: &[f32; 3]| {
        let [a, b, c] = key(*point);
        let around = (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [a + i, b + j, c + k])));
        let mut near = around.filter_map(|cell| cells.get(&cell)).flatten();
        near.any(|&p| is_near(p, *point))
    };
    truth.iter().filter(|point| is_found(point)).count()
}

/// Whether two points are one, up to 1 mm of range and 0.01°.
fn is_near(a: [f32; 3], b: [f32; 3]) -> bool {
    let (a, b) = (glam(a), glam(b));
    (a.length() - b.length()).abs() < 1e-3 && a.angle_between(b).to_degrees() < 0.01
}

fn glam(point: [f32; 3]) -> DVec3 {
    Vec3::from_array(point).as_dvec3()
}

fn check(name: &str, sensor: Sensor, calibration: &str, beams: usize) {
    let Some(recording) = recording(name, sensor, calibration) else {
        return;
    };
    let Recording { sweeps, decoder, truth } = &recording;
    println!("{name}: {:?}", decoder.counts());
    for Sweep {
        scan,
        is_whole,
        packets,
        turn,
        ..
    } in sweeps
    {
        let times = scan.times.as_ref().unwrap();
        let last = times.iter().fold(0.0, |last: f32, &t| last.max(t));
        println!(
            "  {} returns, {packets} packets, whole {is_whole}, turn {turn:.3}, {last:.4} s",
            scan.points.len()
        );
        assert_eq!(scan.check(), Ok(()));
    }
    assert_eq!(found(truth, sweeps), truth.len());
    // The comparison fails where it should: a degree off, nothing is found but what lies on the axis.
    let mut turned = sweeps.clone();
    for point in turned.iter_mut().flat_map(|sweep| &mut sweep.scan.points) {
        *point = Quat::from_rotation_z(0.0175).mul_vec3(*point);
    }
    assert!(found(truth, &turned) < truth.len() / 10);
    assert_eq!(decoder.counts().lost, 0);
    let model = decoder.model().unwrap();
    assert_eq!(model.rings(), beams);
    let rings = |scan: &Scan| scan.rings.as_ref().unwrap().iter().copied().max();
    assert_eq!(
        sweeps.iter().filter_map(|sweep| rings(&sweep.scan)).max(),
        Some(beams as u16 - 1)
    );
}

#[test]
fn pandar40p_decodes_as_its_driver() {
    check("40p", Sensor::Pandar40p, "Pandar40P.csv", 40);
}

#[test]
fn pandar64_decodes_as_its_driver() {
    check("64", Sensor::Pandar64, "Pandar64.csv", 64);
}

#[test]
fn qt64_decodes_as_its_driver() {
    check("qt64", Sensor::Qt64, "PandarQT64.csv", 64);
}

#[test]
fn xt32_decodes_as_its_driver() {
    check("xt32", Sensor::Xt32, "PandarXT32.csv", 32);
}

#[test]
fn vlp32c_decodes_as_its_driver() {
    check("vlp32", Sensor::Vlp32c, "VLP32.yaml", 32);
}

#[test]
fn vlp16_decodes_as_its_driver() {
    check("vlp16", Sensor::Vlp16, "VLP16.yaml", 16);
}

/// The only driver's cloud that tells times: nanoseconds in the packet. The driver was told that each firing is reported once, but these
/// packets report it twice; so its times tell the firing's number among the packet's 24 and the laser, and from these follows the time.
#[test]
fn vlp16_fires_when_its_driver_says() {
    let Some(recording) = recording("vlp16", Sensor::Vlp16, "VLP16.yaml") else {
        return;
    };
    let logs = logs().unwrap();
    let number = |row: &[u8], at: usize| u32::from_le_bytes(row[at..at + 4].try_into().unwrap());
    let float = |row: &[u8], at: usize| f32::from_bits(number(row, at));
    // Microseconds in the hour at which each packet began.
    let packets = bag::packets(&std::fs::read(file(&logs.join("vlp16"), "db3")).unwrap());
    assert!(packets.iter().all(|(_, packet)| packet[1204] == 0x39));
    let mut begins: Vec<i64> = packets
        .iter()
        .map(|(_, packet)| i64::from(number(packet, 1200)))
        .collect();
    begins.sort_unstable();
    let mut decoded: Vec<([f32; 3], i64)> = Vec::new();
    for Sweep { scan, .. } in &recording.sweeps {
        let (begin_ns, times) = (scan.time_ns.unwrap(), scan.times.as_ref().unwrap());
        let at = |secs: f32| begin_ns + (f64::from(secs) * 1e9).round() as i64;
        decoded.extend(scan.points.iter().zip(times).map(|(p, &secs)| (p.to_array(), at(secs))));
    }
    decoded.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
    let mut off_ns: i64 = 0;
    let rows = rows(&file(&logs.join("vlp16"), "pcd"));
    for row in &rows {
        let point = [float(row, 0), float(row, 4), float(row, 8)];
        let told_ns = f64::from(number(row, row.len() - 4));
        let firing = (told_ns / 55_296.0).floor();
        let laser_ns = told_ns - firing * 55_296.0;
        // Two blocks of two firings each: those of the second one are the first ones again.
        let true_firing = (firing / 4.0).floor() * 2.0 + firing % 2.0;
        let wanted_ns = (true_firing * 55_296.0 + laser_ns) as i64;
        let from = decoded.partition_point(|(p, _)| p[0] < point[0] - 0.03);
        let near = decoded[from..].iter().take_while(|(p, _)| p[0] < point[0] + 0.03);
        let same = near.filter(|(p, _)| is_near(*p, point));
        // How far from the beginning of a packet, after that time is taken off.
        let off = same.map(|(_, time_ns)| {
            let micros = (time_ns - wanted_ns).rem_euclid(3_600_000_000_000);
            let next = begins.partition_point(|&begin| begin * 1000 < micros);
            let around = [next.saturating_sub(1), next.min(begins.len() - 1)];
            around
                .map(|i| (begins[i] * 1000 - micros).abs())
                .into_iter()
                .min()
                .unwrap()
        });
        off_ns = off_ns.max(off.min().expect("each point is there"));
    }
    println!("{} times, at most {off_ns} ns off", rows.len());
    assert!(off_ns < 1000, "{off_ns} ns");
}
