//! What a user wants of every run: `tsdfuse/settings.toml` in the folder of settings (`$XDG_CONFIG_HOME`, or `~/.config`).

use std::path::PathBuf;

use anyhow::Result;
use serde::Deserialize;

use crate::exit::Usage;

/// What may be set. Nothing here changes a map.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct UserSettings {
    /// Whether `fuse` leaves a picture beside each mesh.
    pub(crate) picture: bool,
}

/// The user's settings; the defaults if there is no such file.
pub(crate) fn settings() -> Result<UserSettings> {
    let Some(path) = path().filter(|path| path.is_file()) else {
        return Ok(UserSettings::default());
    };
    let wrong = |reason: String| Usage::new(format_args!("{}: {}", path.display(), reason.trim().replace('\n', " ")));
    let text = std::fs::read_to_string(&path).map_err(|error| wrong(error.to_string()))?;
    Ok(toml::from_str(&text).map_err(|error| wrong(error.message().to_owned()))?)
}

fn path() -> Option<PathBuf> {
    let folder = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    let config = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")))?;
    Some(config.join("tsdfuse").join("settings.toml"))
}
