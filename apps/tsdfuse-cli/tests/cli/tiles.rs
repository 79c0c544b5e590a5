//! Meshes as 3D Tiles.

use std::fs;

use serde_json::Value;

use crate::run::{Folder, names, tsdfuse};

#[test]
fn tiles_are_the_same_of_a_run_a_map_and_a_store() {
    let folder = Folder::new();
    let set = folder.simulate("street", "street", "vlp16", 6, &["--motion"]);
    let [map, store] = ["street.tsdf", "street.store"].map(|name| folder.text(name));
    let [run, mapped, stored] = ["run", "mapped", "stored"].map(|name| folder.text(&format!("{name}/tileset.json")));
    let fuse = [
        "fuse",
        &set,
        "--json",
        "-o",
        &run,
        "--save-map",
        &map,
        "--memory",
        "16M",
        "--store",
        &store,
    ];
    let report = tsdfuse(&fuse).succeeded().json();
    let tiles = |report: &Value| report["mesh"]["tiles"]["tiles"].as_u64().unwrap();
    assert_eq!(names(&folder.path("run")).len() as u64, tiles(&report) + 1);
    let json = fs::read(&run).unwrap();
    assert!(serde_json::from_slice::<Value>(&json).unwrap()["root"]["content"]["uri"].is_string());
    for (from, to) in [(&map, &mapped), (&store, &stored)] {
        let run = tsdfuse(&["mesh", from, "-o", to, "--json"]).succeeded();
        assert!(run.stderr.contains("  tiles    "), "{}", run.stderr);
        assert_eq!(run.json()["mesh"]["triangles"], report["mesh"]["triangles"]);
        assert!(fs::read(to).unwrap() == json);
    }
    // The same with a store that is gone afterwards.
    let hidden = folder.text("hidden/tileset.json");
    tsdfuse(&["fuse", &set, "-o", &hidden, "--memory", "16M"]).succeeded();
    assert!(fs::read(&hidden).unwrap() == json);
    assert!(names(&folder.path("")).iter().all(|name| !name.starts_with('.')));
    // A store becomes a single mesh, too.
    let ply = folder.text("street.ply");
    let one = tsdfuse(&["mesh", &store, "-o", &ply, "--json"]).succeeded().json();
    assert_eq!(one["mesh"]["triangles"], report["mesh"]["triangles"]);

    let told = tsdfuse(&["mesh", &map, "-o", &mapped]).failed(2);
    assert!(told.contains("mapped: is not empty; name a new folder"), "{told}");
    let told = tsdfuse(&["mesh", &map, "-o", &run, "--min-weight=-1"]).failed(2);
    assert!(told.contains("min_weight"), "{told}");
    let told = tsdfuse(&[
        "fuse",
        &set,
        "-o",
        &folder.text("new/tileset.json"),
        "--mesh-every",
        "2",
    ])
    .failed(2);
    assert!(told.contains("--mesh-every"), "{told}");
    let told = tsdfuse(&["mesh", &store, "-o", &folder.text("a.stl")]).failed(2);
    assert!(told.contains("a mesh is written as "), "{told}");
    // An empty surface leaves no folder behind.
    let told = tsdfuse(&[
        "mesh",
        &map,
        "-o",
        &folder.text("none/tileset.json"),
        "--min-weight",
        "30000",
    ]);
    assert!(
        told.code == 1 && told.stderr.contains("no triangle with a weight of 30000"),
        "{}",
        told.stderr
    );
    assert!(!folder.path("none").exists());
}
