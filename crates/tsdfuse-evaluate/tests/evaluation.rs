//! Methods side by side on a simulated sphere, in this process.

#![allow(clippy::unwrap_used)] // the setting for tests does not reach their helpers

use std::cell::Cell;
use std::fs;
use std::path::Path;

use tempfile::TempDir;
use tsdfuse_evaluate::{
    Comparing, Contest, Error, Evaluation, Form, PoseNoise, Progress, Tuning, in_this_process, tables,
};
use tsdfuse_io::plain::Writer;
use tsdfuse_run::Job;
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};

/// A sphere of 2 m, seen from 8 places around it.
fn sphere() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene::by_name("sphere", 0).unwrap();
    let path = path::by_name("orbit", &scene, 8).unwrap();
    let config = SimulatorConfig {
        noise: NoiseModel::none(),
        ..Default::default()
    };
    let simulator = Simulator::new(scene, tsdfuse::sensor::model("pandar64").unwrap(), path, config).unwrap();
    let mut writer = Writer::create(folder.path()).unwrap();
    writer.write_sensor(simulator.sensor()).unwrap();
    for scan in simulator.scans() {
        writer.write_scan(&scan).unwrap();
    }
    writer.finish().unwrap();
    folder
}

fn evaluation(log: &Path, forms: &[&str]) -> Evaluation {
    let contest = Contest {
        forms: Form::chosen(forms, &[]).unwrap(),
        hold_out: Some(4),
        ..Contest::of(log)
    };
    Evaluation {
        runs: 2,
        comparing: Comparing {
            samples: Some(1000),
            ..Comparing::default()
        },
        ..Evaluation::of(contest)
    }
}

/// The file of a scan that is broken from now on.
fn break_a_scan(log: &Path) -> String {
    let name = "000003.bin";
    fs::write(log.join("velodyne").join(name), [1; 7]).unwrap();
    name.to_owned()
}

#[test]
fn each_method_is_measured_and_methods_take_turns() {
    let log = sphere();
    let mut jobs: Vec<String> = Vec::new();
    let mut run = in_this_process();
    let mut runner = |job: &Job| {
        let held_out = job
            .input
            .selection
            .hold_out
            .map_or(String::new(), |every| format!(" 1/{every}"));
        jobs.push(job.settings.texts().join(" ") + &held_out);
        run(job)
    };
    let mut steps = 0;
    let mut watch = |progress: Progress<'_>| steps += usize::from(matches!(progress, Progress::Step));
    let methods = ["raycast", "depth", "raycast-projective"];
    let found = evaluation(log.path(), &methods).run(&mut runner, &mut watch).unwrap();
    let [plain, depth, projective] = [
        "method=raycast",
        "method=depth",
        "method=raycast raycast.distance=projective",
    ];
    let held_out = |form: &str| form.to_owned() + " 1/4";
    assert_eq!(
        jobs,
        [
            plain.to_owned(),
            held_out(plain),
            depth.to_owned(),
            projective.to_owned(),
            held_out(projective),
            plain.to_owned(),
            projective.to_owned()
        ]
    );
    // The points of the reference, and the runs of all methods that there are.
    assert_eq!(steps, 8 + 3 + 2);
    let results = found.results;
    assert_eq!((results.methods.len(), results.failed.len()), (2, 1));
    assert_eq!(results.failed[0].name, "depth");
    for row in &results.methods {
        assert_eq!((row.scans_per_sec.len(), row.scan_secs.len()), (2, 8));
        assert!(row.scans_per_sec.contains(&row.speed.scans_per_sec));
        assert!(row.held_out.as_ref().unwrap().hit_rate > 0.1, "{:?}", row.held_out);
        assert!(row.mesh_secs > 0.0 && row.fused_share > 0.9, "{row:?}");
    }
    let titles: Vec<String> = tables::of(&results).into_iter().map(|table| table.title).collect();
    assert!(titles.contains(&"Held-out scans".to_owned()), "{titles:?}");
}

#[test]
fn without_any_method_that_can_be_used_the_reason_is_told() {
    let log = sphere();
    let calls = Cell::new(0);
    let mut broken = |_: &Job| {
        calls.set(calls.get() + 1);
        Err("on purpose".to_owned())
    };
    let found = evaluation(log.path(), &["raycast", "normals"]).run(&mut broken, &mut |_| {});
    let told = found.unwrap_err().to_string();
    assert_eq!(told, "no method could be run; raycast: on purpose");
    assert_eq!(calls.get(), 2);
    // Wrong options are found before anything is run.
    let mut wrong = evaluation(log.path(), &["raycast"]);
    wrong.contest.margin_m = Some(f64::NAN);
    assert!(matches!(wrong.run(&mut broken, &mut |_| {}), Err(Error::Config(_))));
    assert_eq!(calls.get(), 2);
}

#[test]
fn a_search_skips_bad_scans_as_all_runs_do() {
    let log = sphere();
    let name = break_a_scan(log.path());
    let mut tuning = Tuning::of(Contest {
        forms: Form::chosen(&["raycast"], &[]).unwrap(),
        hold_out: Some(4),
        ..Contest::of(log.path())
    });
    tuning.contest.settings.set_text("map.voxel_size_m=0.1").unwrap();
    tuning.contest.settings.set_text("map.truncation_m=0.3").unwrap();
    let mut notes = String::new();
    let mut watch = |progress: Progress<'_>| {
        if let Progress::Note(note) = progress {
            notes += note;
        }
    };
    assert!(tuning.run(&mut watch).is_err());
    assert!(notes.contains(&name), "{notes}");
    tuning.contest.input.skip_bad = true;
    let found = tuning.run(&mut |_| {}).unwrap();
    assert_eq!((found.ranking.len(), found.scans, found.all_scans), (1, 8, 8));
    assert_eq!(found.skipped_scans.len(), 1);
    assert!(
        found.skipped_scans[0].reason.contains(&name),
        "{:?}",
        found.skipped_scans
    );
}

#[test]
fn noise_is_added_to_the_poses_that_are_fused_and_to_no_others() {
    let log = sphere();
    let with = |noise: &str| {
        let mut evaluation = evaluation(log.path(), &["raycast"]);
        evaluation.runs = 1;
        evaluation.contest.pose_noise = Some(PoseNoise::parse(noise).unwrap());
        let found = evaluation.run(&mut in_this_process(), &mut |_| {}).unwrap();
        let figures = serde_json::to_value(&found.results).unwrap();
        let row = &found.results.methods[0];
        let error_m = row.surface.all.mesh_to_reference.stats.mean_m;
        (error_m, row.held_out.as_ref().unwrap().capped_error_m, figures)
    };
    let (exact, exact_held_out, _) = with("0,0");
    let (noisy, noisy_held_out, figures) = with("0.05,0.5");
    assert!(noisy > 2.0 * exact, "{noisy} {exact}");
    assert!(noisy_held_out > exact_held_out, "{noisy_held_out} {exact_held_out}");
    assert_eq!(figures["dataset"]["pose_noise"]["position_m"], 0.05);
    // The same noise again.
    assert_eq!(with("0.05,0.5").0, noisy);
}
