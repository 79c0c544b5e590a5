//! Live views, in a real browser.

use crate::browser::{Browser, chromium};
use crate::run::{Folder, tsdfuse};
use crate::serving::Serving;

#[cfg(unix)]
#[test]
fn a_run_is_watched_while_it_grows_and_stays_until_it_is_interrupted() {
    let Some(chromium) = chromium() else { return };
    let folder = Folder::new();
    let log = folder.simulate("log", "street", "vlp16", 30, &[]);
    let (mesh, plain) = (folder.text("street.ply"), folder.text("plain.ply"));
    let coarse = ["--voxel-size", "0.2", "--truncation", "0.6"];
    tsdfuse(&[&["fuse", &log, "-o", &plain][..], &coarse].concat()).succeeded();
    let serving = Serving::start(
        &[&["fuse", &log, "-o", &mesh, "--view=127.0.0.1:0"][..], &coarse].concat(),
        "view ",
    );
    assert!(serving.url.starts_with("http://127.0.0.1:"), "{}", serving.url);
    let mut browser = Browser::open(&chromium, &serving.url, [800, 600]);
    // In the end it shows all triangles of the mesh; watching changes no bit of it.
    browser.wait("tsdfuse.state().path === 30 && tsdfuse.state().figures.some((row) => row.startsWith('scans30'))");
    let text = String::from_utf8_lossy(&std::fs::read(&plain).unwrap()).into_owned();
    let faces = text
        .lines()
        .find_map(|line| line.strip_prefix("element face "))
        .unwrap()
        .to_owned();
    browser.wait(&format!("tsdfuse.state().triangles === {faces}"));
    let shot = browser.shot();
    let grey = shot
        .pixels
        .iter()
        .filter(|[r, g, b]| r.abs_diff(*g) < 6 && g.abs_diff(*b) < 10)
        .count();
    assert!(grey * 10 > shot.pixels.len(), "{grey}");
    assert_eq!(browser.errors, [""; 0]);
    assert!(
        browser
            .requests
            .iter()
            .all(|url| url.contains("127.0.0.1") || url.starts_with("blob:")),
        "{:?}",
        browser.requests
    );
    let (code, told) = serving.interrupt();
    assert_eq!(code, 0, "{told:?}");
    assert_eq!(std::fs::read(&mesh).unwrap(), std::fs::read(&plain).unwrap());
}

#[test]
fn meshes_maps_and_tiles_are_viewed() {
    let Some(chromium) = chromium() else { return };
    let folder = Folder::new();
    let log = folder.simulate("log", "street", "vlp16", 6, &[]);
    let (map, mesh, tiles) = (
        folder.text("a.tsdf"),
        folder.text("a.ply"),
        folder.text("tiles/tileset.json"),
    );
    tsdfuse(&[
        "fuse",
        &log,
        "-o",
        &mesh,
        "--save-map",
        &map,
        "--voxel-size",
        "0.2",
        "--truncation",
        "0.6",
    ])
    .succeeded();
    let mut paths = vec![map.clone(), mesh];
    if cfg!(feature = "tiles") {
        tsdfuse(&["mesh", &map, "-o", &tiles]).succeeded();
        paths.push(tiles);
    }
    let mut counts = Vec::new();
    for path in paths {
        let serving = Serving::start(&["view", &path, "--address", "127.0.0.1:0"], "view ");
        let mut browser = Browser::open(&chromium, &serving.url, [800, 600]);
        if path.ends_with(".json") {
            browser.wait("tsdfuse.state().tiles > 0");
        } else {
            // Pieces come in several messages.
            match counts.first() {
                Some(count) => browser.wait(&format!("tsdfuse.state().triangles === {count}")),
                None => browser.wait("tsdfuse.state().triangles > 0 && tsdfuse.state().status === ''"),
            }
            let mut count = serde_json::Value::Null;
            while count != browser.state()["triangles"] {
                count = browser.state()["triangles"].clone();
                std::thread::sleep(std::time::Duration::from_secs(2));
            }
            counts.push(count);
        }
        browser.key("Digit2");
        let shot = browser.shot();
        let vivid = shot
            .pixels
            .iter()
            .filter(|p| p.iter().max().unwrap() - p.iter().min().unwrap() > 120)
            .count();
        assert!(vivid > 5_000, "{path}: {vivid}");
        assert_eq!(browser.errors, [""; 0], "{path}");
    }
    assert_eq!(counts[0], counts[1]);
}
