//! What is compared: methods, each with settings of its own.

use serde::Serialize;
use tsdfuse::fuse::Method;
use tsdfuse_run::Settings;

use crate::error::{Error, Result};
use crate::scan_poses::ScanPoses;

/// A method with settings of its own: a row of the tables.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Form {
    /// Its name in the tables.
    pub name: String,
    /// The method.
    pub method: Method,
    /// `key=value`, as [`Settings::set_text`] takes it. Empty: the method's default form.
    pub settings: Vec<String>,
    /// Whose poses it fuses with.
    pub poses: ScanPoses,
}

/// Forms of a method other than its default.
const NOTABLE: [(Method, &str, &str); 5] = [
    (Method::Raycast, "projective", "raycast.distance=projective"),
    (Method::Normals, "holz", "normals.estimator=holz"),
    (Method::Surfels, "ground-flip", "surfel.ground_flip=true"),
    // Discs of 1 σ, as the text of the thesis says.
    (Method::Surfels, "literal", "surfel.radius_sigmas=1"),
    (Method::Roldao, "streaming", "roldao.form=streaming"),
];

/// The name that stands for all of them.
const ALL: &str = "all";

impl Form {
    /// All methods, each followed by its notable forms.
    pub fn all() -> Vec<Self> {
        let forms = Method::ALL.iter().flat_map(|&method| {
            let default = Self {
                name: method.name().to_owned(),
                method,
                settings: Vec::new(),
                poses: ScanPoses::Given,
            };
            let others = NOTABLE.iter().filter(move |other| other.0 == method);
            std::iter::once(default).chain(others.map(|(method, name, setting)| Self {
                name: format!("{}-{name}", method.name()),
                method: *method,
                settings: vec![(*setting).to_owned()],
                poses: ScanPoses::Given,
            }))
        });
        forms.collect()
    }

    /// The names of all of them.
    pub fn names() -> Vec<String> {
        Self::all().into_iter().map(|form| form.name).collect()
    }

    /// Reads `METHOD:KEY=VALUE[,KEY=VALUE]`.
    fn parse(text: &str) -> Result<Self> {
        let wanted = || {
            Error::config(format_args!(
                "--method-set {text}: expected METHOD:KEY=VALUE[,KEY=VALUE], as in raycast:raycast.distance=projective"
            ))
        };
        let (method, settings) = text.split_once(':').ok_or_else(wanted)?;
        let settings: Vec<String> = settings.split(',').map(|s| s.trim().to_owned()).collect();
        if settings.iter().any(|s| !s.contains('=')) {
            return Err(wanted());
        }
        let wrong = |error| Error::config(format_args!("--method-set {text}: {error}"));
        Ok(Self {
            name: text.to_owned(),
            method: method.trim().parse().map_err(wrong)?,
            settings,
            poses: ScanPoses::Given,
        })
    }

    /// The forms with these names, then those that are written out as `METHOD:KEY=VALUE[,KEY=VALUE]`. `all` stands for all
    /// names, and so do two empty lists.
    ///
    /// # Errors
    /// [`Error::Config`] for an unknown name, and for a form that is listed twice.
    pub fn chosen<T: AsRef<str>>(names: &[T], written_out: &[T]) -> Result<Vec<Self>> {
        let mut names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
        if names.is_empty() && written_out.is_empty() {
            names.push(ALL);
        }
        let all = Self::all();
        let mut chosen: Vec<Self> = Vec::new();
        for name in names {
            let count = chosen.len();
            chosen.extend(all.iter().filter(|form| name == ALL || form.name == name).cloned());
            if chosen.len() == count {
                let known = Self::names().join(", ");
                return Err(Error::config(format_args!("no method {name}; there are all, {known}")));
            }
        }
        for text in written_out {
            chosen.push(Self::parse(text.as_ref())?);
        }
        match (1..chosen.len()).find(|&i| chosen[..i].contains(&chosen[i])) {
            Some(twice) => Err(Error::config(format_args!("{} is listed twice", chosen[twice].name))),
            None => Ok(chosen),
        }
    }

    /// Each form with each of these poses, as rows of their own.
    pub fn with_poses(forms: &[Self], poses: &[ScanPoses]) -> Vec<Self> {
        let with = |form: &Self, poses: ScanPoses| Self {
            name: match poses {
                ScanPoses::Given => form.name.clone(),
                ScanPoses::Refine | ScanPoses::Track => format!("{} ({})", form.name, poses.name()),
            },
            poses,
            ..form.clone()
        };
        let each = forms
            .iter()
            .flat_map(|form| poses.iter().map(move |&poses| (form, poses)));
        each.map(|(form, poses)| with(form, poses)).collect()
    }

    /// Settings with this method and its own settings on top.
    ///
    /// # Errors
    /// [`Error::Config`] for a key or value that does not exist.
    pub fn over(&self, settings: &Settings) -> Result<Settings> {
        let mut settings = settings.clone();
        settings.set("--method", "method", self.method.name())?;
        self.settings.iter().try_for_each(|text| settings.set_text(text))?;
        Ok(settings)
    }

    /// The file that its mesh is kept in.
    pub fn mesh_name(&self) -> String {
        let keep = |c: char| {
            if c.is_ascii_alphanumeric() || "-.=".contains(c) {
                c
            } else {
                '_'
            }
        };
        let stem: String = self.name.chars().map(keep).collect();
        stem + ".ply"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(names: &[&str], written_out: &[&str]) -> Result<Vec<String>, String> {
        let forms = Form::chosen(names, written_out).map_err(|e| e.to_string())?;
        Ok(forms.into_iter().map(|form| form.name).collect())
    }

    #[test]
    fn forms_are_chosen_by_name_or_written_out() {
        let all = chosen(&[], &[]).unwrap();
        assert_eq!(all.len(), Method::ALL.len() + NOTABLE.len());
        assert_eq!(chosen(&["all"], &[]).unwrap(), all);
        assert_eq!(
            chosen(&["normals", "raycast-projective"], &[]).unwrap(),
            ["normals", "raycast-projective"]
        );
        let written = "raycast:raycast.distance=projective,map.max_weight=9";
        assert_eq!(chosen(&[], &[written]).unwrap(), [written]);
        assert_eq!(chosen(&["surfel"], &[written]).unwrap(), ["surfel", written]);
        let form = Form::parse(written).unwrap();
        assert_eq!(
            form.mesh_name(),
            "raycast_raycast.distance=projective_map.max_weight=9.ply"
        );
    }

    #[test]
    fn each_method_stands_beside_itself_with_other_poses() {
        let forms = Form::chosen(&["patch", "raycast"], &[]).unwrap();
        let names = |poses: &[ScanPoses]| {
            let forms = Form::with_poses(&forms, poses);
            forms.into_iter().map(|form| form.name).collect::<Vec<_>>()
        };
        assert_eq!(names(&[ScanPoses::Given]), ["patch", "raycast"]);
        assert_eq!(
            names(&[ScanPoses::Given, ScanPoses::Track]),
            ["patch", "patch (track)", "raycast", "raycast (track)"]
        );
    }

    #[test]
    fn a_form_goes_before_other_settings() {
        let mut settings = Settings::default();
        settings.set_text("map.max_weight=3").unwrap();
        settings.set_text("method=normals").unwrap();
        let form = Form::parse("raycast:raycast.distance=projective,map.max_weight=9").unwrap();
        let mut texts = form.over(&settings).unwrap().texts();
        texts.sort();
        assert_eq!(
            texts,
            ["map.max_weight=9", "method=raycast", "raycast.distance=projective"]
        );
        for form in Form::all() {
            form.over(&settings).unwrap();
        }
        let wrong = Form::parse("raycast:raycast.distance=far").unwrap();
        assert!(matches!(wrong.over(&settings), Err(Error::Config(_))));
    }

    #[test]
    fn what_is_not_a_form_is_named() {
        let told = chosen(&["magic"], &[]).unwrap_err();
        assert!(
            told.starts_with("no method magic; there are all, raycast, raycast-projective, normals"),
            "{told}"
        );
        let wrong = |text: &str| chosen(&[], &[text]).unwrap_err();
        assert!(wrong("raycast").contains("expected METHOD:KEY=VALUE[,KEY=VALUE]"));
        assert!(wrong("raycast:x").contains("expected METHOD"));
        assert!(wrong("magic:a=b").contains("--method-set magic:a=b: no method magic"));
        assert_eq!(
            chosen(&["surfel", "surfel"], &[]).unwrap_err(),
            "surfel is listed twice"
        );
    }
}
