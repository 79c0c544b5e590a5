//! `tsdfuse fuse --save-map`, and what can be done with the map.

use std::fs;

use crate::run::{Folder, names, tsdfuse};

#[test]
fn a_saved_map_gives_the_mesh_that_fusing_gave() {
    let folder = Folder::new();
    let set = folder.simulate(
        "box",
        "box",
        "vlp16",
        4,
        &["--motion", "--offset", "691000,5335000,520"],
    );
    let map = folder.text("box.tsdf");
    for (extension, more) in [("ply", &[][..]), ("glb", &["--min-weight", "0.2"]), ("obj", &[])] {
        let [fused, again] = ["fused", "again"].map(|name| folder.text(&format!("{name}.{extension}")));
        let fuse = [&["fuse", &set, "-o", &fused, "--save-map", &map, "--json"], more].concat();
        let report = tsdfuse(&fuse).succeeded().json();
        assert_eq!(report["saved_map"]["path"], map.as_str());
        assert_eq!(report["saved_map"]["bytes"], fs::metadata(&map).unwrap().len());
        let mesh = [&["mesh", &map, "-o", &again, "--json"], more].concat();
        let done = tsdfuse(&mesh).succeeded().json();
        assert_eq!(
            (&done["map"], &done["mesh"]["triangles"]),
            (&report["map"], &report["mesh"]["triangles"])
        );
        let [fused, again] = [fused, again].map(|path| fs::read(path).unwrap());
        assert!(fused.len() > 10_000, "{extension}: {}", fused.len());
        assert!(fused == again, "{extension}");
    }
    // The map alone is a result too, and the same one.
    let alone = folder.text("alone.tsdf");
    let report = tsdfuse(&["fuse", &set, "--save-map", &alone, "--json", "--threads", "1"]);
    let report = report.succeeded().json();
    assert!(report["mesh"].is_null());
    assert!(fs::read(alone).unwrap() == fs::read(map).unwrap());
}

#[test]
fn a_saved_map_is_described() {
    let folder = Folder::new();
    let set = folder.simulate("sphere", "sphere", "pandar64", 6, &[]);
    let map = folder.text("sphere.tsdf");
    let fuse = ["fuse", &set, "--save-map", &map, "--truncation", "0.15", "--json"];
    let report = tsdfuse(&fuse).succeeded().json();
    let info = tsdfuse(&["info", &map, "--json"]).succeeded().json();
    for key in ["blocks", "observed_voxels"] {
        assert!(
            info[key].as_u64().unwrap() > 100 && info[key] == report["map"][key],
            "{key}: {info}"
        );
    }
    assert_eq!(info["config"], report["config"]["map"]);
    // A sphere of 2 m without its poles, which no beam reaches, and the band around it.
    for (corner, side) in [(0, -1.0), (1, 1.0)] {
        for axis in 0..2 {
            let off = info["extent_m"][corner][axis].as_f64().unwrap() * side - 2.0;
            assert!((-0.2..0.3).contains(&off), "corner {corner}, axis {axis}: {off}");
        }
    }
    let table = String::from_utf8(tsdfuse(&["info", &map]).succeeded().stdout).unwrap();
    for line in [
        "voxel size  0.05 m\n",
        "truncation  0.15 m\n",
        "blocks      ",
        "extent      4.",
    ] {
        assert!(table.contains(line), "{line}: {table}");
    }
}

#[test]
fn what_is_wrong_with_a_map_is_said_in_one_line() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let (map, mesh) = (folder.text("box.tsdf"), folder.text("mesh.ply"));
    let line = tsdfuse(&["fuse", &set, "--save-map", &folder.text("no/box.tsdf")]).failed(1);
    assert!(line.contains("no/box.tsdf: there is no folder"), "{line}");
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let line = tsdfuse(&["mesh", &map, "-o", &folder.text("mesh.stl")]).failed(2);
    assert!(
        line.contains("mesh.stl: a mesh is written as .ply, .glb or .obj"),
        "{line}"
    );
    let line = tsdfuse(&["mesh", &map, "-o", &mesh, "--min-weight=-1"]).failed(2);
    assert!(line.contains("min_weight must be 0 or more, not -1"), "{line}");
    let line = tsdfuse(&["mesh", &map, "-o", &mesh, "--min-weight", "1000"]).failed(1);
    assert!(line.contains("no triangle at a weight of 1000 or more"), "{line}");
    let mut bytes = fs::read(&map).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&map, &bytes).unwrap();
    for arguments in [&["mesh", &map, "-o", &mesh][..], &["info", &map]] {
        let line = tsdfuse(arguments).failed(1);
        assert!(line.contains("box.tsdf: group ") && line.contains("checksum"), "{line}");
    }
    fs::write(&map, "ply\n").unwrap();
    let line = tsdfuse(&["mesh", &map, "-o", &mesh]).failed(1);
    assert!(line.contains("box.tsdf: the file ends within its header"), "{line}");
    fs::write(&map, [b'x'; 100]).unwrap();
    let line = tsdfuse(&["mesh", &map, "-o", &mesh]).failed(1);
    assert!(
        line.contains("box.tsdf: its header: this is no map saved by tsdfuse"),
        "{line}"
    );
    assert_eq!(names(&folder.path("")), ["box", "box.tsdf"]);
}
