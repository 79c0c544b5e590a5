//! `tsdfuse info`.

use std::fs;

use crate::run::{Folder, tsdfuse};

#[test]
fn a_simulated_set_is_described() {
    let folder = Folder::new();
    let set = folder.simulate("plane", "plane", "vlp16", 5, &["--path", "vehicle", "--motion"]);
    let info = tsdfuse(&["info", &set, "--json", "--sample", "2"]).succeeded().json();
    assert_eq!((&info["scans"], &info["sample"]["scans"]), (&5.into(), &2.into()));
    assert_eq!(
        (&info["sensor"]["name"], &info["sensor_guessed"]),
        (&"vlp16".into(), &false.into())
    );
    for (key, want) in [("rate_hz", 10.0), ("duration_secs", 0.4), ("path_length_m", 4.0)] {
        assert!(
            (info[key].as_f64().unwrap() / want - 1.0).abs() < 0.1,
            "{key}: {}",
            info[key]
        );
    }
    for key in ["with_rings", "with_times", "with_motion", "with_intensities"] {
        assert_eq!(info["sample"][key], 2, "{key}");
    }
    let [low, high] = [0, 1].map(|corner| info["sample"]["extent_m"][corner][2].as_f64().unwrap());
    assert!(
        low.abs() < 1e-3 && high.abs() < 1e-3,
        "the plane is z = 0, not {low} to {high}"
    );

    let table = String::from_utf8(tsdfuse(&["info", &set]).succeeded().stdout).unwrap();
    for line in [
        "sensor      vlp16: 16 beams",
        "scans       5 in 0.40 s, 10.00 Hz",
        "(all scans read)",
        "motion      yes",
    ] {
        assert!(table.contains(line), "{line}: {table}");
    }
}

#[test]
fn the_sensor_is_guessed_and_unreadable_scans_are_named() {
    let folder = Folder::new();
    let set = folder.simulate("hall", "hall", "vlp16", 3, &[]);
    fs::remove_file(folder.path("hall/sensor.toml")).unwrap();
    fs::write(folder.path("hall/velodyne/000001.bin"), [0; 7]).unwrap();
    let run = tsdfuse(&["info", &set]);
    let table = String::from_utf8(run.stdout).unwrap();
    assert_eq!(run.code, 3, "{}", run.stderr);
    assert!(table.contains("sensor      vlp16, guessed"), "{table}");
    assert!(
        table.contains("unreadable  ") && table.contains("000001.bin: "),
        "{table}"
    );
}
