//! The help texts, as they are agreed on. After a change on purpose: `TSDFUSE_BLESS=1 cargo test -p tsdfuse-cli help`.

use std::path::Path;

use crate::run::tsdfuse;

#[test]
fn help_texts_are_as_agreed() {
    for (name, arguments) in [
        ("tsdfuse", &["--help"][..]),
        ("fuse", &["fuse", "--help"]),
        ("evaluate", &["evaluate", "--help"]),
        ("bench", &["bench", "--help"]),
        ("map", &["map", "--help"]),
        ("map_merge", &["map", "merge", "--help"]),
        ("map_crop", &["map", "crop", "--help"]),
        ("map_transform", &["map", "transform", "--help"]),
        ("mesh", &["mesh", "--help"]),
        ("resume", &["resume", "--help"]),
        ("render", &["render", "--help"]),
        ("simulate", &["simulate", "--help"]),
        ("info", &["info", "--help"]),
        ("convert", &["convert", "--help"]),
        ("eval", &["eval", "--help"]),
        ("poses", &["poses", "--help"]),
        ("poses_compare", &["poses", "compare", "--help"]),
        ("poses_convert", &["poses", "convert", "--help"]),
    ] {
        let text = String::from_utf8(tsdfuse(arguments).succeeded().stdout).unwrap();
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/cli/help/{name}.txt"));
        if std::env::var_os("TSDFUSE_BLESS").is_some() {
            std::fs::write(path, text).unwrap();
        } else {
            assert_eq!(
                text,
                std::fs::read_to_string(path).unwrap(),
                "the help of {name} has changed"
            );
        }
    }
}

#[test]
fn the_version_is_the_crates() {
    let text = String::from_utf8(tsdfuse(&["--version"]).succeeded().stdout).unwrap();
    assert_eq!(text, format!("tsdfuse {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn without_arguments_the_help_is_shown() {
    let run = tsdfuse(&[]);
    assert_eq!(run.code, 2);
    assert!(run.stderr.contains("Usage: tsdfuse <COMMAND>"), "{}", run.stderr);
}
