//! The words that repeat a job on a command line.

use std::path::Path;

use tsdfuse_run::{Device, Job, PosesFrom};

/// Settings that have a flag of their own.
const FLAGS: [(&str, &str); 6] = [
    ("method", "--method"),
    ("map.voxel_size_m", "--voxel-size"),
    ("map.truncation_m", "--truncation"),
    ("range.min_range_m", "--min-range"),
    ("range.max_range_m", "--max-range"),
    ("mesh.min_weight", "--min-weight"),
];

/// The command line `tsdfuse fuse …` that does what a job does, quoted for a shell where that is necessary. Settings that
/// were read from a file are written out, so it needs no such file.
pub fn of(job: &Job) -> String {
    let mut words: Vec<String> = Vec::new();
    let mut option = |flag: &str, value: Option<String>| {
        words.extend(value.into_iter().flat_map(|value| [flag.to_owned(), value]));
    };
    let path = |path: &Option<_>| path.as_deref().map(|path: &Path| path.display().to_string());
    let input = &job.input;
    let file = path(&input.options.poses);
    option(
        "--poses",
        match (job.poses, file) {
            (PosesFrom::Any | PosesFrom::Log, file) => file,
            (PosesFrom::Track, _) => Some("track".to_owned()),
            (PosesFrom::Refine, None) => Some("refine".to_owned()),
            (PosesFrom::Refine, Some(file)) => Some(format!("refine:{file}")),
        },
    );
    let sensors = input.options.sensors.join(",");
    option("--sensor", Some(sensors).filter(|sensors| !sensors.is_empty()));
    let selection = &input.selection;
    let is_all = (selection.from, selection.to, selection.step) == (0, None, 1);
    option("--scans", (!is_all).then(|| selection.to_string()));
    option("--hold-out", selection.hold_out.map(|every| every.to_string()));
    for text in job.settings.texts() {
        let flag = FLAGS.iter().find_map(|(key, flag)| {
            let value = text.strip_prefix(key)?.strip_prefix('=')?;
            Some((*flag, value.to_owned()))
        });
        let (flag, value) = flag.unwrap_or_else(|| ("--set", text.clone()));
        option(flag, Some(value));
    }
    option("--device", (job.device != Device::Cpu).then(|| job.device.to_string()));
    option("--memory", job.memory_bytes.map(|bytes| bytes.to_string()));
    option("--store", path(&job.store));
    let commits = job.store.is_some() && job.commit_every > 0;
    option("--commit-every", commits.then(|| job.commit_every.to_string()));
    option("--load-map", path(&job.load_map));
    let outputs = &job.outputs;
    option("--mesh-every", outputs.mesh_every.map(|every| every.to_string()));
    option("--save-map", path(&outputs.map));
    option("--preview", path(&outputs.preview));
    option("--report", path(&outputs.report));
    option("-o", path(&outputs.mesh));
    let start = [
        "tsdfuse".to_owned(),
        "fuse".to_owned(),
        input.path.display().to_string(),
    ];
    let flags = input.skip_bad.then(|| "--skip-bad".to_owned());
    let words = start.into_iter().chain(flags).chain(words);
    words.map(quoted).collect::<Vec<_>>().join(" ")
}

/// A word as a POSIX shell reads it.
fn quoted(word: String) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+=:,@%".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word;
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse_io::{OpenOptions, Selection};
    use tsdfuse_run::{Input, Outputs, Settings};

    #[test]
    fn a_job_becomes_the_command_that_repeats_it() {
        let mut settings = Settings::default();
        for text in ["method=raycast", "map.voxel_size_m=0.1", "raycast.distance=projective"] {
            settings.set_text(text).unwrap();
        }
        let mut job = Job {
            input: Input {
                path: "my logs/it's".into(),
                ..Input::default()
            },
            settings,
            outputs: Outputs {
                mesh: Some("mesh.ply".into()),
                ..Outputs::default()
            },
            ..Job::default()
        };
        let told = of(&job);
        assert!(told.starts_with(r"tsdfuse fuse 'my logs/it'\''s' "), "{told}");
        assert!(told.ends_with(" -o mesh.ply"), "{told}");
        for part in [
            " --method raycast ",
            " --voxel-size 0.1 ",
            " --set raycast.distance=projective ",
        ] {
            assert!(told.contains(part), "{told}");
        }
        assert!(!told.contains("--scans") && !told.contains("--skip-bad"), "{told}");
        job.input.selection = Selection {
            from: 3,
            to: Some(9),
            step: 2,
            hold_out: Some(4),
        };
        job.input.options = OpenOptions {
            poses: Some("p.txt".into()),
            sensors: vec!["left".into(), "right".into()],
            ..OpenOptions::default()
        };
        job.input.skip_bad = true;
        job.device = Device::Gpu(Some("llvm".to_owned()));
        let told = of(&job);
        for part in [
            " --skip-bad ",
            " --poses p.txt ",
            " --sensor left,right ",
            " --scans 3..9:2 ",
            " --hold-out 4 ",
            " --device gpu:llvm ",
        ] {
            assert!(told.contains(part), "{told}");
        }
    }
}
