//! What is compared: methods, each with settings of its own.

use serde::Serialize;
use tsdfuse::fuse::Method;

use crate::exit::Usage;
use crate::settings::Settings;

/// A method with settings of its own: a row of the tables.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Form {
    /// What the tables call it.
    pub(crate) name: String,
    pub(crate) method: Method,
    /// `key=value`, as for `--set`.
    pub(crate) settings: Vec<String>,
}

/// Forms of a method other than its default.
const NOTABLE: [(Method, &str, &str); 4] = [
    (Method::Raycast, "projective", "raycast.distance=projective"),
    (Method::Normals, "holz", "normals.estimator=holz"),
    (Method::Surfel, "ground-flip", "surfel.ground_flip=true"),
    (Method::Roldao, "batch", "roldao.form=batch"),
];

/// The name that stands for all of them.
const ALL: &str = "all";

impl Form {
    /// All methods, each followed by its notable forms.
    pub(crate) fn all() -> Vec<Self> {
        let forms = Method::ALL.iter().flat_map(|&method| {
            let default = Self {
                name: method.name().to_owned(),
                method,
                settings: Vec::new(),
            };
            let others = NOTABLE.iter().filter(move |other| other.0 == method);
            std::iter::once(default).chain(others.map(|(method, name, setting)| Self {
                name: format!("{}-{name}", method.name()),
                method: *method,
                settings: vec![(*setting).to_owned()],
            }))
        });
        forms.collect()
    }

    /// The names of all of them.
    pub(crate) fn names() -> Vec<String> {
        Self::all().into_iter().map(|form| form.name).collect()
    }

    /// A form as it stands on the command line: `METHOD:KEY=VALUE[,KEY=VALUE]`.
    fn parse(text: &str) -> Result<Self, Usage> {
        let wanted = || {
            Usage::new(format_args!(
                "--method-set {text}: METHOD:KEY=VALUE[,KEY=VALUE] is wanted, as in raycast:raycast.distance=projective"
            ))
        };
        let (method, settings) = text.split_once(':').ok_or_else(wanted)?;
        let settings: Vec<String> = settings.split(',').map(|s| s.trim().to_owned()).collect();
        if settings.iter().any(|s| !s.contains('=')) {
            return Err(wanted());
        }
        let method = method
            .trim()
            .parse()
            .map_err(|e| Usage::new(format_args!("--method-set {text}: {e}")))?;
        Ok(Self {
            name: text.to_owned(),
            method,
            settings,
        })
    }

    /// The forms of these names, then the ones that are written out; all, if nothing is asked for.
    pub(crate) fn chosen(names: &[String], written_out: &[String]) -> Result<Vec<Self>, Usage> {
        let all = Self::all();
        let mut chosen = Vec::new();
        let default = [ALL.to_owned()];
        let names = if names.is_empty() && written_out.is_empty() {
            &default
        } else {
            names
        };
        for name in names {
            let count = chosen.len();
            chosen.extend(all.iter().filter(|form| name == ALL || form.name == *name).cloned());
            if chosen.len() == count {
                let known = Self::names().join(", ");
                return Err(Usage::new(format_args!("no method {name}; there are all, {known}")));
            }
        }
        for text in written_out {
            chosen.push(Self::parse(text)?);
        }
        match (1..chosen.len()).find(|&i| chosen[..i].contains(&chosen[i])) {
            Some(twice) => Err(Usage::new(format_args!("{} is asked for twice", chosen[twice].name))),
            None => Ok(chosen),
        }
    }

    /// The arguments of `tsdfuse fuse` that ask for it.
    pub(crate) fn arguments(&self) -> Vec<String> {
        let method = ["--method".to_owned(), self.method.name().to_owned()];
        let settings = self.settings.iter().flat_map(|s| ["--set".to_owned(), s.clone()]);
        method.into_iter().chain(settings).collect()
    }

    /// The command that makes a mesh with it.
    pub(crate) fn command(&self, settings: &Settings) -> String {
        let mut words = vec!["tsdfuse fuse".to_owned(), settings.dataset.display().to_string()];
        words.extend(
            settings
                .arguments()
                .iter()
                .map(|word| word.to_string_lossy().into_owned()),
        );
        words.extend(self.arguments());
        words.join(" ") + " -o mesh.ply"
    }

    /// Its name as a file's.
    pub(crate) fn file_stem(&self) -> String {
        let keep = |c: char| {
            if c.is_ascii_alphanumeric() || "-.=".contains(c) {
                c
            } else {
                '_'
            }
        };
        self.name.chars().map(keep).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(names: &[&str], written_out: &[&str]) -> Result<Vec<String>, String> {
        let [names, written_out] = [names, written_out].map(|l| l.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>());
        let forms = Form::chosen(&names, &written_out).map_err(|e| e.to_string())?;
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
        let arguments = "--method raycast --set raycast.distance=projective --set map.max_weight=9";
        assert_eq!(form.arguments().join(" "), arguments);
        assert_eq!(form.file_stem(), "raycast_raycast.distance=projective_map.max_weight=9");
    }

    #[test]
    fn what_is_not_a_form_is_named() {
        let told = chosen(&["magic"], &[]).unwrap_err();
        assert!(
            told.starts_with("no method magic; there are all, raycast, raycast-projective, normals"),
            "{told}"
        );
        assert!(
            chosen(&[], &["raycast"])
                .unwrap_err()
                .contains("METHOD:KEY=VALUE[,KEY=VALUE] is wanted")
        );
        assert!(chosen(&[], &["raycast:x"]).unwrap_err().contains("is wanted"));
        assert!(
            chosen(&[], &["magic:a=b"])
                .unwrap_err()
                .contains("--method-set magic:a=b: no method magic")
        );
        assert_eq!(
            chosen(&["surfel", "surfel"], &[]).unwrap_err(),
            "surfel is asked for twice"
        );
    }
}
