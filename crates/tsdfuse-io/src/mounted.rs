//! Which of several sensors in one recording are read, and where they sit on what carries them.

use std::path::Path;

use tsdfuse::Pose;

use crate::error::{Error, Result};
use crate::source::OpenOptions;

/// The sensors that are read.
#[derive(Debug)]
pub(crate) struct Mounted {
    /// Of those that could be chosen.
    pub(crate) is_kept: Vec<bool>,
    /// `body_from_sensor` of those that are kept.
    pub(crate) body_from_sensor: Vec<Pose>,
    pub(crate) notes: Vec<String>,
}

impl Mounted {
    /// All sensors, if they were named, or if the recording tells where they sit and there are poses; otherwise the one with the largest of the
    /// `amounts`. The recording says of each where it sits, or does not.
    ///
    /// # Errors
    /// If extrinsics are given for several sensors.
    pub(crate) fn choose(
        path: &Path,
        names: &[String],
        amounts: &[usize],
        told: &[Option<Pose>],
        has_poses: bool,
        options: &OpenOptions,
    ) -> Result<Self> {
        let is_told = told.iter().all(Option::is_some) && told.iter().flatten().any(|pose| *pose != Pose::IDENTITY);
        let (mut is_kept, mut notes) = (vec![true; names.len()], Vec::new());
        let most = amounts
            .iter()
            .max()
            .and_then(|most| amounts.iter().position(|amount| amount == most));
        if let Some(main) = most.filter(|_| names.len() > 1 && options.sensors.is_empty() && !(is_told && has_poses)) {
            let why = if is_told {
                "there are no poses, and odometry follows one sensor".to_owned()
            } else {
                format!("where it sits relative to {} is not told", names[main])
            };
            for (i, name) in names.iter().enumerate().filter(|(i, _)| *i != main) {
                is_kept[i] = false;
                notes.push(format!("{name} is not read: {why}; --sensor {name} would choose it"));
            }
        }
        let kept: Vec<usize> = (0..names.len()).filter(|&i| is_kept[i]).collect();
        if kept.len() > 1 {
            if options.extrinsics.is_some() {
                let reason = "has several sensors, and extrinsics are those of one: choose it with --sensor";
                return Err(Error::dataset(path, reason));
            }
            let all: Vec<&str> = kept.iter().map(|&i| names[i].as_str()).collect();
            notes.push(if is_told {
                format!("{} are read together; --sensor chooses", all.join(", "))
            } else {
                format!(
                    "where {} sit is not told: they are taken to sit in one place",
                    all.join(", ")
                )
            });
        }
        let pose = |&i: &usize| options.extrinsics.or(told[i]).unwrap_or_default();
        Ok(Self {
            body_from_sensor: kept.iter().map(pose).collect(),
            is_kept,
            notes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::DVec3;

    #[test]
    fn several_sensors_are_read_together_only_where_they_are_known_to_sit() {
        let names = ["a", "b"].map(str::to_owned);
        let beside = Pose {
            translation: DVec3::Y,
            ..Pose::IDENTITY
        };
        let chosen = |told: [Option<Pose>; 2], has_poses, options: &OpenOptions| {
            Mounted::choose(Path::new("log"), &names, &[2, 3], &told, has_poses, options)
        };
        let any = OpenOptions::default();
        let told = [Some(Pose::IDENTITY), Some(beside)];
        let both = chosen(told, true, &any).unwrap();
        assert_eq!(
            (both.is_kept, both.body_from_sensor),
            (vec![true; 2], vec![Pose::IDENTITY, beside])
        );
        for (told, has_poses, why) in [
            (told, false, "there are no poses"),
            (
                [Some(Pose::IDENTITY); 2],
                true,
                "where it sits relative to b is not told",
            ),
            ([None, Some(beside)], true, "where it sits relative to b is not told"),
        ] {
            let one = chosen(told, has_poses, &any).unwrap();
            assert_eq!((one.is_kept, one.body_from_sensor.len()), (vec![false, true], 1));
            assert!(one.notes[0].contains(why), "{:?}", one.notes);
        }
        let named = OpenOptions {
            sensors: names.to_vec(),
            ..OpenOptions::default()
        };
        let asked = chosen([None; 2], true, &named).unwrap();
        assert!(asked.is_kept == [true; 2] && asked.notes[0].contains("taken to sit in one place"));
        let placed = OpenOptions {
            extrinsics: Some(beside),
            ..named
        };
        assert!(
            chosen(told, true, &placed)
                .unwrap_err()
                .to_string()
                .contains("choose it with --sensor")
        );
    }
}
