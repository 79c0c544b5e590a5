use std::thread;

use super::*;
use crate::{Log, Selection};

/// A packet of a VLP-16 at so many packets after azimuth 0, ten turns a second.
fn vlp16(i: u32) -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12 {
        packet.extend([0xFF, 0xEE]);
        packet.extend((((480 * i + block * 40) % 36_000) as u16).to_le_bytes());
        (0..32).for_each(|_| packet.extend([0xE8, 3, 9]));
    }
    packet.extend((i * 1327).to_le_bytes());
    packet.extend([0x37, 0x22]);
    packet
}

/// The same of an HDL-32E.
fn hdl32e(i: u32) -> Vec<u8> {
    let mut packet = vlp16(i);
    packet[1205] = 0x21;
    packet
}

/// Its packet of a position that is sent at the same time as packet `i` of returns: it turns left at i counts.
fn position(i: u32) -> Vec<u8> {
    let mut packet = vec![0; 512];
    packet[30..32].copy_from_slice(&(i as u16).to_le_bytes());
    // Gravity, along the first axis of two accelerometers.
    for at in [18, 26] {
        packet[at..at + 2].copy_from_slice(&819_u16.to_le_bytes());
    }
    packet[198..202].copy_from_slice(&(i * 1327).to_le_bytes());
    let text = format!(
        "GPRMC,0000{:05.2},A,3630.0,N,00224.0,W,0.0,0.0,010170,,",
        f64::from(i / 75) / 10.0
    );
    let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
    let sentence = format!("${text}*{sum:02X}\r\n");
    packet[206..206 + sentence.len()].copy_from_slice(sentence.as_bytes());
    packet
}

/// Sends packets of returns to the first port, a packet of a position to the second one with every fourth.
fn send_both(ports: [u16; 2], numbers: std::ops::Range<u32>, pause: Duration) -> thread::JoinHandle<()> {
    thread::spawn(move || {
        let [returns, beside] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        thread::sleep(Duration::from_millis(200));
        for number in numbers {
            returns.send_to(&hdl32e(number), ("127.0.0.1", ports[0])).unwrap();
            if number % 4 == 0 {
                beside.send_to(&position(number), ("127.0.0.1", ports[1])).unwrap();
            }
            thread::sleep(pause);
        }
    })
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Sends packets of these numbers to the port, as fast as `pause` lets it.
fn send(port: u16, numbers: impl Iterator<Item = u32> + Send + 'static, pause: Duration) -> thread::JoinHandle<()> {
    thread::spawn(move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        // Until somebody listens, the first packets are lost.
        thread::sleep(Duration::from_millis(200));
        for number in numbers {
            socket.send_to(&vlp16(number), ("127.0.0.1", port)).unwrap();
            thread::sleep(pause);
        }
    })
}

fn opened(port: u16, sensors: &[&str]) -> Log {
    opened_at(&format!("127.0.0.1:{port}"), sensors)
}

fn opened_at(address: &str, sensors: &[&str]) -> Log {
    let options = OpenOptions {
        sensors: sensors.iter().map(ToString::to_string).collect(),
        ..OpenOptions::default()
    };
    crate::open_with(format!("udp://{address}"), &options).unwrap()
}

#[test]
fn sweeps_come_as_they_are_sent_and_lost_packets_are_counted() {
    let port = free_port();
    // Packets 100 and 101 are lost, 31 and 30 are swapped.
    let numbers = (0..250).filter(|i| !(100..102).contains(i)).map(|i| match i {
        30 => 31,
        31 => 30,
        i => i,
    });
    let sender = send(port, numbers, Duration::from_micros(300));
    let log = opened(port, &[]);
    assert_eq!((log.len(), log.sensors()[0].name.as_str()), (None, "vlp16"));
    assert!(log.is_unplaced() && log.notes()[0].starts_with("vlp16 packets come from 127.0.0.1:"));
    let scans: Vec<_> = log.read_ahead(&Selection::default()).collect();
    sender.join().unwrap();
    // Three turns and a third; the last third counts, too.
    assert_eq!(scans.len(), 4, "{:?}", log.news());
    for read in &scans[..3] {
        let scan = read.scan.as_ref().unwrap();
        assert!(
            scan.points.len() >= 73 * 384 && scan.pose.is_none(),
            "{}",
            scan.points.len()
        );
    }
    let news = log.news();
    assert_eq!(news, [format!("udp://127.0.0.1:{port}: 248 packets, 2 lost, 1 late")]);
}

#[test]
fn what_is_kept_is_read_again_bit_for_bit() {
    let port = free_port();
    let sender = send(port, 0..250, Duration::from_micros(300));
    let log = opened(port, &[]);
    let folder = tempfile::tempdir().unwrap();
    assert!(log.keep(folder.path()).unwrap());
    let mut scans = log.read_ahead(&Selection::default());
    let streamed: Vec<_> = scans.by_ref().take(3).collect();
    sender.join().unwrap();
    let recording = log.recording().unwrap();
    assert_eq!(recording.len(), Some(3), "{:?}", recording.notes());
    assert_eq!(recording.sensors(), log.sensors());
    // Keeping began within the first sweep.
    for (index, read) in streamed.iter().enumerate().skip(1) {
        let (first, again) = (read.scan.as_ref().unwrap(), recording.read(index).unwrap());
        assert_eq!(first.time_ns, again.time_ns);
        assert!(first.points == again.points && first.times == again.times && first.rings == again.rings);
        assert!(first.intensities == again.intensities && !again.points.is_empty());
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    // Though somebody waits for more.
    drop((log, scans));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn samples_come_with_the_sweeps_in_whose_time_they_are_and_fixes_are_kept() {
    let ports = [free_port(), free_port()];
    let sender = send_both(ports, 0..300, Duration::from_micros(300));
    let log = opened_at(&format!("127.0.0.1:{},{}", ports[0], ports[1]), &[]);
    let folder = tempfile::tempdir().unwrap();
    assert!(log.keep(folder.path()).unwrap());
    let scans: Vec<_> = log.read_ahead(&Selection::default()).collect();
    sender.join().unwrap();
    let mut samples: Vec<ImuSample> = Vec::new();
    for read in &scans {
        samples.extend(&read.imu);
        // The last sweep waits for samples in vain.
        let scan = read.scan.as_ref().unwrap();
        let last = scan.times.as_ref().unwrap().iter().copied().fold(0.0, f32::max);
        let end_ns = ns_after(scan.time_ns.unwrap(), last.into());
        assert!(
            read.index == 3 || samples.last().unwrap().time_ns >= end_ns,
            "{}",
            read.index
        );
    }
    assert!(scans.len() >= 4 && samples.is_sorted_by_key(|sample| sample.time_ns));
    for sample in &samples {
        let i = (sample.time_ns - samples[0].time_ns) as f64 / 1.327e6
            + samples[0].angular_velocity.z.to_degrees() / 0.097_66;
        assert!(
            (sample.angular_velocity.z.to_degrees() / 0.097_66 - i).abs() < 1e-6,
            "{sample:?}"
        );
        assert!((sample.acceleration.z - 9.806_65).abs() < 0.01, "{sample:?}");
    }
    // What was kept tells the same, but for what came before.
    let recording = log.recording().unwrap();
    let again = recording.imu().unwrap();
    assert!(
        again.len() > 60 && samples.ends_with(&again),
        "{} {}",
        again.len(),
        samples.len()
    );
    assert!(recording.gnss().unwrap().len() >= 2, "{:?}", recording.notes());
    assert_eq!(log.news().len(), 1, "{:?}", log.news());
}

#[test]
fn samples_that_nobody_asks_for_are_forgotten() {
    let ports = [free_port(), free_port()];
    let sender = send_both(ports, 0..75 * 24, Duration::from_micros(200));
    let log = opened_at(&format!("127.0.0.1:{},{}", ports[0], ports[1]), &[]);
    let mut scans = log.read_ahead(&Selection::default());
    let first = scans.next().unwrap();
    sender.join().unwrap();
    let mut last = first.imu.last().unwrap().time_ns;
    let mut gaps = 0;
    for read in scans {
        assert!(read.imu.len() <= MAX_SAMPLES, "{}", read.imu.len());
        for sample in &read.imu {
            gaps += usize::from(sample.time_ns - last > 50_000_000);
            last = sample.time_ns;
        }
    }
    assert_eq!(gaps, 1, "the oldest ones are missing");
}

#[test]
fn a_port_beside_that_cannot_be_had_is_told() {
    let ports = [free_port(), free_port()];
    let _held = UdpSocket::bind(("127.0.0.1", ports[1])).unwrap();
    let sender = send(ports[0], 0..100, Duration::from_micros(100));
    let address = format!("udp://127.0.0.1:{},{}", ports[0], ports[1]);
    let told = crate::open(&address).unwrap_err().to_string();
    assert!(told.starts_with(&format!("{address}: ")), "{told}");
    sender.join().unwrap();
}

#[test]
fn the_newest_sweep_wins_if_nobody_can_keep_up() {
    let port = free_port();
    let sender = send(port, 0..75 * 12, Duration::from_micros(200));
    let log = opened(port, &["VLP-16"]);
    let mut scans = log.read_ahead(&Selection::default());
    let first = scans.next().unwrap();
    assert_eq!(first.index, 0);
    // Nobody takes a scan until all were sent.
    sender.join().unwrap();
    let rest: Vec<_> = scans.collect();
    assert!(rest.len() <= 4, "{}", rest.len());
    let last_ns = rest.last().unwrap().scan.as_ref().unwrap().time_ns.unwrap();
    let passed_ns = last_ns - first.scan.unwrap().time_ns.unwrap();
    assert!(passed_ns > 1_000_000_000, "the last turn is there: {passed_ns}");
    let left_out = log
        .news()
        .iter()
        .any(|news| news.contains("sweeps came faster than they could be fused"));
    assert!(left_out, "{:?}", log.news());
}

#[test]
fn a_reader_that_stops_does_not_wait() {
    let port = free_port();
    let sender = send(port, 0..100, Duration::from_micros(100));
    let log = opened(port, &[]);
    let mut scans = log.read_ahead(&Selection::default());
    sender.join().unwrap();
    assert!(scans.next_unless(|| false).is_some());
    let begin = Instant::now();
    assert!(
        scans
            .next_unless(|| begin.elapsed() > Duration::from_millis(20))
            .is_none()
    );
    assert!(begin.elapsed() < Duration::from_millis(500));
}

#[test]
fn what_cannot_be_listened_to_is_told() {
    let told = |address: &str, options: &OpenOptions| crate::open_with(address, options).unwrap_err().to_string();
    let plain = OpenOptions::default();
    assert_eq!(
        told("udp://", &plain),
        "udp://: has no port: udp://:2368, or udp://HOST:2368"
    );
    assert_eq!(
        told("udp://:0", &plain),
        "udp://:0: has no port: udp://:2368, or udp://HOST:2368"
    );
    let port = free_port();
    let silent = format!("udp://127.0.0.1:{port}");
    assert_eq!(
        told(&silent, &plain),
        format!("{silent}: no packet of a LiDAR came within {SILENCE_SECS} s")
    );
    let odd = OpenOptions {
        sensors: vec!["mid360".into()],
        ..OpenOptions::default()
    };
    assert!(told(&silent, &odd).contains("mid360 is no sensor whose packets are known: vlp16, "));
    let held = UdpSocket::bind(("127.0.0.1", port)).unwrap();
    assert!(told(&silent, &plain).starts_with(&format!("{silent}: ")));
    drop(held);
}
