use super::*;

fn file() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/logs/ouster/osf_fw_3.2_10scans.osf");
    if !path.is_file() {
        eprintln!("skipped: no {}", path.display());
        return None;
    }
    Some(path)
}

/// Against what ouster-sdk 1.0.1 makes of it: returns, sums of the coordinates, their magnitudes, times, reflectivity.
#[test]
fn scans_are_as_in_the_sdk() {
    let Some(path) = file() else { return };
    let log = crate::open(&path).unwrap();
    let sensor = &log.sensors()[0];
    assert_eq!(
        (log.format(), log.len(), sensor.name.as_str()),
        ("Ouster OSF", Some(10), "os0-8")
    );
    assert!(log.is_unplaced());
    for (index, time_ns, returns, sum, magnitude, times, intensity, first) in [
        (
            0,
            6_846_799_867_874,
            6156,
            [23_486.529, -16_187.53, 3_575.299],
            [25_910.908, 32_660.726, 11_830.246],
            313.654119,
            60_232.0,
            [-0.20099, 0.71071, -0.45655],
        ),
        (
            9,
            6_847_699_872_269,
            6104,
            [24_134.162, -15_731.529, 3_339.73],
            [25_607.025, 31_599.445, 11_686.615],
            310.663071,
            48_023.0,
            [-0.19924, 0.70438, -0.45198],
        ),
    ] {
        let scan = log.read(index).unwrap();
        assert_eq!((scan.time_ns, scan.points.len()), (Some(time_ns), returns));
        assert!(scan.points[0].distance(first.into()) < 2e-5, "{}", scan.points[0]);
        let added = |f: fn(f64) -> f64| {
            let points = scan.points.iter().map(|p| p.as_dvec3().to_array().map(f));
            points.fold([0.0; 3], |sum: [f64; 3], p| {
                [sum[0] + p[0], sum[1] + p[1], sum[2] + p[2]]
            })
        };
        for (found, told) in [(added(|v| v), sum), (added(f64::abs), magnitude)] {
            assert!(
                found.iter().zip(told).all(|(a, b): (&f64, f64)| (a - b).abs() < 0.1),
                "{found:?} {told:?}"
            );
        }
        let total = |column: &Option<Vec<f32>>| -> f64 { column.iter().flatten().map(|&v| f64::from(v)).sum() };
        assert!((total(&scan.times) - times).abs() < 1e-3 && total(&scan.intensities) == intensity);
    }
}

/// Two sensors that the SDK placed on a vehicle, and the vehicle at each column: `testdata/osf/make.py`.
#[test]
fn sensors_are_where_extrinsics_and_poses_of_columns_place_them() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/osf/posed.osf");
    // How far the farthest return is off the wall x = 20 m.
    let off = |log: &crate::Log| {
        let scans = (0..log.len().unwrap()).map(|index| log.read(index).unwrap());
        let points = scans.flat_map(|scan| scan.points_in_world().unwrap().collect::<Vec<_>>());
        points.fold(0.0, |most: f64, p| most.max((p.x - 20.0).abs()))
    };
    let log = crate::open(&path).unwrap();
    let names: Vec<String> = log.sensors().iter().map(|sensor| sensor.name.clone()).collect();
    assert_eq!((log.len(), names.len()), (Some(4), 2));
    assert!((0..4).all(|index| log.read(index).unwrap().points.len() > 400));
    assert!(off(&log) < 1e-3, "{}", off(&log));
    assert!(
        log.notes()
            .iter()
            .any(|note| note.ends_with("are read together; --sensor chooses"))
    );
    let opened = |extrinsics: Option<Pose>| {
        let options = OpenOptions {
            sensors: vec![names[1].clone()],
            extrinsics,
            ..Default::default()
        };
        crate::open_with(&path, &options).unwrap()
    };
    let one = opened(None);
    assert!(one.len() == Some(2) && off(&one) < 1e-3);
    // Elsewhere, the wall is another.
    assert!(off(&opened(Some(Pose::IDENTITY))) > 1.0);
    // Poses of a file place the vehicle, too; scans that it does not cover are left out.
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("vehicle.tum");
    let line = |k: i32| {
        let t = f64::from(k) / 20.0;
        let (sin, cos) = (0.05 * t).sin_cos();
        format!("{:.6} {} {} 0 0 0 {sin} {cos}\n", 1e9 + 0.1 * t, 2.0 * t, 0.3 * t)
    };
    std::fs::write(&poses, (0..=60).map(line).collect::<String>()).unwrap();
    let options = OpenOptions {
        poses: Some(poses),
        ..Default::default()
    };
    let placed = crate::open_with(&path, &options).unwrap();
    assert_eq!(placed.len(), Some(4));
    assert!(off(&placed) < 2e-3, "{}", off(&placed));
    std::fs::write(
        folder.path().join("vehicle.tum"),
        (0..=30).map(line).collect::<String>(),
    )
    .unwrap();
    let part = crate::open_with(&path, &options).unwrap();
    assert_eq!(part.len(), Some(3));
    assert!(
        part.notes()
            .iter()
            .any(|note| note.starts_with("1 of 4 scans are left out"))
    );
}

/// Damage is told or harmless, wherever it is.
#[test]
fn damaged_files_are_bearable() {
    let Some(path) = file() else { return };
    let bytes = std::fs::read(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let damaged = folder.path().join("damaged.osf");
    let end = bytes.len();
    // The directory is at the end, the header at the begin.
    let places = (0..60)
        .chain(60..400)
        .chain((end - 4000..end).step_by(7))
        .chain((400..end).step_by(40_009));
    let mut errors = 0;
    for place in places.filter(|place| !(8..12).contains(place)) {
        for value in [0, 0x7F, 0xFF] {
            let mut bad = bytes.clone();
            bad[place] = value;
            std::fs::write(&damaged, &bad).unwrap();
            match crate::open(&damaged) {
                Ok(log) => errors += usize::from((0..log.len().unwrap_or(0).min(2)).any(|i| log.read(i).is_err())),
                Err(told) => {
                    errors += 1;
                    assert!(told.to_string().contains("damaged.osf"), "{told}");
                }
            }
        }
    }
    assert!(errors > 20, "{errors}");
    for length in [12, 59, 100, end / 2, end - 20] {
        std::fs::write(&damaged, &bytes[..length]).unwrap();
        assert!(crate::open(&damaged).is_err(), "{length}");
    }
}
