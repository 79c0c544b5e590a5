//! The names of several pictures.

use std::path::{Path, PathBuf};

/// The name of a picture: that of `--output`, with the view's number if there are several, and the kind's name likewise.
pub(super) fn of(output: &Path, (view, views): (usize, usize), (kind, kinds): (&str, usize)) -> PathBuf {
    let mut stem = output.file_stem().unwrap_or_default().to_os_string();
    if views > 1 {
        let digits = (views - 1).to_string().len().max(2);
        stem.push(format!("-{view:0digits$}"));
    }
    if kinds > 1 {
        stem.push(format!("-{kind}"));
    }
    stem.push(".");
    stem.push(output.extension().unwrap_or_default());
    output.with_file_name(stem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbered_and_say_what_they_show_where_they_must() {
        let named = |view, views, kinds| {
            let path = of(Path::new("a.b/view.x.PNG"), (view, views), ("depth", kinds));
            path.to_str().unwrap().to_owned()
        };
        assert_eq!(named(0, 1, 1), "a.b/view.x.PNG");
        assert_eq!(named(0, 1, 2), "a.b/view.x-depth.PNG");
        assert_eq!(named(7, 10, 1), "a.b/view.x-07.PNG");
        assert_eq!(named(7, 101, 2), "a.b/view.x-007-depth.PNG");
    }
}
