//! `tsdfuse fuse --save-map` and `--load-map`, `tsdfuse map`, and what else can be done with a saved map.

use std::fs;

use tsdfuse_io::map_file::{self, FusedPose};

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
fn a_run_with_a_break_gives_the_map_of_one_without() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 8, &["--motion"]);
    let [whole, half, rest] = ["whole", "half", "rest"].map(|name| folder.text(&format!("{name}.tsdf")));
    for method in [
        "raycast",
        "normals",
        "surfel",
        "cylindrical",
        "kuehner",
        "caminal",
        "roldao",
        "patch",
    ] {
        let common = [
            "fuse",
            &set,
            "--method",
            method,
            "--voxel-size",
            "0.1",
            "--set",
            "map.max_weight=2",
            "--set",
            "roldao.form=streaming",
        ];
        let fuse = |more: &[&str]| tsdfuse(&[&common[..], more].concat()).succeeded();
        fuse(&["--save-map", &whole]);
        fuse(&["--save-map", &half, "--scans", "0..5"]);
        // The map's own settings go on where none are named.
        let again = [
            "fuse",
            &set,
            "--method",
            method,
            "--load-map",
            &half,
            "--scans",
            "5..8",
            "--set",
            "roldao.form=streaming",
        ];
        let report = tsdfuse(&[&again[..], &["--save-map", &rest, "--json"]].concat())
            .succeeded()
            .json();
        assert!(report["loaded_map"]["integrations"].as_u64().unwrap() >= 5, "{report}");
        let [whole, half, rest] = [&whole, &half, &rest].map(|path| fs::read(path).unwrap());
        assert!(whole == rest && whole != half, "{method}");
    }
}

#[test]
fn a_map_that_cannot_be_continued_is_refused() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 2, &[]);
    let [map, mesh] = [folder.text("box.tsdf"), folder.text("mesh.ply")];
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let refused = |more: &[&str]| tsdfuse(&[&["fuse", &set, "--load-map", &map, "-o", &mesh], more].concat()).failed(2);
    let line = refused(&["--voxel-size", "0.1"]);
    assert!(
        line.contains("box.tsdf: the map has voxel_size_m = 0.05, but the settings say 0.1"),
        "{line}"
    );
    let line = refused(&["--set", "map.max_weight=3"]);
    assert!(line.contains("max_weight = 32768, but the settings say 3"), "{line}");
    let line = refused(&["--method", "roldao", "--set", "roldao.form=batch"]);
    assert!(
        line.contains("box.tsdf: roldao.form = batch fits planes to all scans at once"),
        "{line}"
    );
    let line = tsdfuse(&["fuse", &set, "--load-map", &mesh, "-o", &mesh]).failed(1);
    assert!(line.contains("mesh.ply: No such file"), "{line}");
}

#[test]
fn maps_of_parts_merge_to_the_map_of_all() {
    let folder = Folder::new();
    let set = folder.simulate("box", "box", "vlp16", 6, &[]);
    let [all, a, b, merged] = ["all", "a", "b", "merged"].map(|name| folder.text(&format!("{name}.tsdf")));
    let fuse = |map: &str, scans: &str, more: &[&str]| {
        tsdfuse(&[&["fuse", &set, "--save-map", map, "--scans", scans], more].concat()).succeeded()
    };
    fuse(&all, "0..6", &[]);
    fuse(&a, "0..4", &[]);
    fuse(&b, "4..6", &[]);
    let done = tsdfuse(&["map", "merge", &a, &b, "-o", &merged, "--json"]).succeeded();
    assert_eq!(done.json()["limited_voxels"], 0);
    assert!(fs::read(&all).unwrap() == fs::read(&merged).unwrap());
    fuse(&b, "4..6", &["--voxel-size", "0.1"]);
    let line = tsdfuse(&["map", "merge", &a, &b, "-o", &merged]).failed(1);
    assert!(
        line.contains("b.tsdf: the maps differ in voxel_size_m: 0.05 and 0.1"),
        "{line}"
    );
    for (map, scans) in [(&a, "0..4"), (&b, "4..6")] {
        fuse(map, scans, &["--set", "map.max_weight=1"]);
    }
    let run = tsdfuse(&["map", "merge", &a, &b, "-o", &merged]).succeeded();
    assert!(run.stderr.contains("voxels reached max_weight"), "{}", run.stderr);
}

#[test]
fn maps_are_cropped_resampled_moved_and_repaired() {
    let folder = Folder::new();
    let set = folder.simulate("sphere", "sphere", "pandar64", 6, &[]);
    let [map, out, back] = ["sphere", "out", "back"].map(|name| folder.text(&format!("{name}.tsdf")));
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let whole = fs::read(&map).unwrap();
    let extent = |path: &str| {
        let info = tsdfuse(&["info", path, "--json"]).succeeded().json();
        let corner = |i: usize| [0, 1, 2].map(|axis| info["extent_m"][i][axis].as_f64().unwrap());
        [corner(0), corner(1)]
    };
    tsdfuse(&[
        "map",
        "crop",
        &map,
        "--from",
        "-5,-5,-0.5",
        "--to",
        "5,5,0.75",
        "-o",
        &out,
    ])
    .succeeded();
    let [low, high] = extent(&out);
    assert!(
        (low[2] + 0.5).abs() < 1e-9 && (high[2] - 0.75).abs() < 1e-9,
        "{low:?} {high:?}"
    );
    let line = tsdfuse(&["map", "crop", &map, "--from", "1,1,1", "--to", "0,2,2", "-o", &out]).failed(2);
    assert!(line.contains("holds nothing"), "{line}");

    let half = tsdfuse(&["map", "resample", &map, "--voxel-size", "0.1", "-o", &out, "--json"]).succeeded();
    let half = half.json()["map"]["observed_voxels"].as_f64().unwrap();
    let info = tsdfuse(&["info", &map, "--json"]).succeeded().json();
    let share = half / info["observed_voxels"].as_f64().unwrap();
    assert!((0.1..0.25).contains(&share), "{share}");
    let line = tsdfuse(&["map", "resample", &map, "--voxel-size", "1", "-o", &out]).failed(1);
    assert!(line.contains("between 1 and 64 voxels"), "{line}");

    let moved = ["--rotation", "0,0,90", "--translation", "691000.05,-2,0.5"];
    let done = tsdfuse(&[&["map", "transform", &map, "-o", &out, "--json"], &moved[..]].concat()).succeeded();
    assert_eq!(done.json()["exact"], true);
    tsdfuse(&[
        "map",
        "transform",
        &out,
        "--translation",
        "-691000.05,2,-0.5",
        "-o",
        &back,
    ])
    .succeeded();
    tsdfuse(&["map", "transform", &back, "--rotation", "0,0,-90", "-o", &out]).succeeded();
    // Every voxel is as it was; the poses of the scans are, too, up to rounding.
    let [(there, moved), (here, poses)] = [&out, &map].map(|path| map_file::read_with_poses(path).unwrap());
    let off = |(a, b): (&FusedPose, &FusedPose)| a.pose.translation.distance(b.pose.translation);
    assert!(there == here && poses.len() == 6 && moved.iter().zip(&poses).map(off).all(|off| off < 1e-8));
    let turned = tsdfuse(&["map", "transform", &map, "--rotation", "0,0,30", "-o", &out]).succeeded();
    assert!(turned.stderr.contains("the map was resampled"), "{}", turned.stderr);

    // A flipped byte loses a group, and no more than that.
    let intact = tsdfuse(&["map", "repair", &map, "-o", &out]).succeeded();
    assert!(intact.stderr.contains("no block is lost") && fs::read(&out).unwrap() == whole);
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 1;
    fs::write(&map, &damaged).unwrap();
    let run = tsdfuse(&["map", "repair", &map, "-o", &out, "--json"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    let done = run.json();
    assert_eq!(done["damage"]["lost_blocks"], 256);
    assert!(
        run.stderr.contains("is lost") && run.stderr.contains("256 blocks are lost"),
        "{}",
        run.stderr
    );
    tsdfuse(&["info", &out]).succeeded();
}

#[test]
fn maps_are_exported_as_arrays_and_as_points() {
    let folder = Folder::new();
    let set = folder.simulate("sphere", "sphere", "pandar64", 6, &[]);
    let [map, volume, points] = ["sphere.tsdf", "sphere.npz", "points.ply"].map(|name| folder.text(name));
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let observed = tsdfuse(&["info", &map, "--json"]).succeeded().json()["observed_voxels"]
        .as_u64()
        .unwrap();
    tsdfuse(&["map", "export", &map, "-o", &volume]).succeeded();
    let bytes = fs::read(&volume).unwrap();
    // Twenty bytes a voxel, and the frames of five arrays.
    assert!((bytes.len() as u64 - 20 * observed) < 2000 && bytes.starts_with(b"PK"));
    tsdfuse(&["map", "export", &map, "-o", &points]).succeeded();
    let cloud = tsdfuse_io::geometry::read(&points).unwrap();
    let tsdfuse_io::geometry::Geometry::Cloud(cloud) = cloud else {
        panic!("no cloud")
    };
    assert!(cloud.len() > 1000 && cloud.iter().all(|p| (p.length() - 2.0).abs() < 0.1));
    let line = tsdfuse(&["map", "export", &map, "-o", &folder.text("a.vdb")]).failed(2);
    assert!(
        line.contains("a.vdb: a map is exported as .npz, .zarr or .ply"),
        "{line}"
    );
}

#[test]
#[cfg(feature = "zarr")]
fn maps_and_stores_are_exported_alike() {
    let folder = Folder::new();
    let set = folder.simulate("sphere", "sphere", "pandar64", 6, &[]);
    let [map, store] = ["sphere.tsdf", "sphere.store"].map(|name| folder.text(name));
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    tsdfuse(&["fuse", &set, "--store", &store, "--memory", "1M"]).succeeded();
    let export = |from: &str, to: &str| tsdfuse(&["map", "export", from, "-o", &folder.text(to)]);
    export(&store, "again.tsdf").succeeded();
    assert!(fs::read(folder.path("again.tsdf")).unwrap() == fs::read(&map).unwrap());
    export(&map, "map.zarr").succeeded();
    export(&store, "store.zarr").succeeded();
    let files = |name| {
        let mut files = Vec::new();
        collect(&folder.path(name), &mut files);
        files
    };
    let of_map = files("map.zarr");
    assert!(of_map.len() > 10 && of_map == files("store.zarr"));
    let line = export(&map, "map.zarr").failed(2);
    assert!(line.contains("map.zarr: is not empty; name a new folder"), "{line}");
    let line = tsdfuse(&["map", "crop", &store, "-o", &folder.text("a.tsdf")]).failed(2);
    assert!(line.contains("sphere.store: is a store; tsdfuse map export"), "{line}");
    let [of_map, of_store] = [&map, &store].map(|path| {
        let picture = folder.text("a.png");
        tsdfuse(&["render", path, "-o", &picture, "--size", "160x90"]).succeeded();
        fs::read(picture).unwrap()
    });
    assert!(of_map == of_store);
    let [of_map, of_store] = [&map, &store].map(|path| tsdfuse(&["info", path, "--json"]).succeeded().json());
    for key in ["config", "blocks", "observed_voxels"] {
        assert!(
            of_map[key] == of_store[key] && !of_map[key].is_null(),
            "{key}: {of_store}"
        );
    }
    let table = String::from_utf8(tsdfuse(&["info", &store]).succeeded().stdout).unwrap();
    assert!(table.contains("scans       6 of 6 stored\n"), "{table}");
    let line = export(&store, "a.npz").failed(2);
    assert!(line.contains("a.npz: a store is exported as .zarr or .tsdf"), "{line}");
}

/// All files below a folder: names and bytes, sorted.
#[cfg(feature = "zarr")]
fn collect(folder: &std::path::Path, files: &mut Vec<(std::ffi::OsString, Vec<u8>)>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(Result::unwrap).collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        if entry.path().is_dir() {
            collect(&entry.path(), files);
        } else {
            files.push((entry.file_name(), fs::read(entry.path()).unwrap()));
        }
    }
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
    // The map is not loaded, and yet its figures are those of the loaded map.
    let loaded = map_file::read(&map).unwrap();
    assert_eq!(
        ["blocks", "observed_voxels", "bytes"].map(|key| info[key].as_u64().unwrap() as usize),
        [
            loaded.block_count(),
            loaded.observed_voxel_count(),
            loaded.memory_bytes()
        ]
    );
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
    assert!(line.contains("no/box.tsdf: no such folder"), "{line}");
    tsdfuse(&["fuse", &set, "--save-map", &map]).succeeded();
    let line = tsdfuse(&["mesh", &map, "-o", &folder.text("mesh.stl")]).failed(2);
    assert!(
        line.contains("mesh.stl: a mesh is written as .ply, .glb or .obj"),
        "{line}"
    );
    let line = tsdfuse(&["mesh", &map, "-o", &mesh, "--min-weight=-1"]).failed(2);
    assert!(line.contains("min_weight must be 0 or more, not -1"), "{line}");
    let line = tsdfuse(&["mesh", &map, "-o", &mesh, "--min-weight", "1000"]).failed(1);
    assert!(line.contains("no triangle with a weight of 1000 or more"), "{line}");
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
    fs::write(
        &map,
        format!("ply\nformat binary_little_endian 1.0\n{}", " ".repeat(100)),
    )
    .unwrap();
    let line = tsdfuse(&["render", &map, "-o", &folder.text("box.png")]).failed(1);
    assert!(
        line.contains("this is a mesh, not a map; `tsdfuse view` shows it"),
        "{line}"
    );
    fs::write(&map, [b'x'; 100]).unwrap();
    let line = tsdfuse(&["mesh", &map, "-o", &mesh]).failed(1);
    assert!(
        line.contains("box.tsdf: its header: this is no map saved by tsdfuse"),
        "{line}"
    );
    assert_eq!(names(&folder.path("")), ["box", "box.tsdf"]);
}

#[test]
fn plans_sections_and_heights_are_cut_out_of_a_map() {
    let folder = Folder::new();
    let log = folder.simulate("log", "street", "vlp16", 4, &[]);
    let map = folder.text("street.tsdf");
    tsdfuse(&[
        "fuse",
        &log,
        "--save-map",
        &map,
        "--voxel-size",
        "0.2",
        "--truncation",
        "0.6",
    ])
    .succeeded();
    let [png, pgm, tif, section, ground, top] = [
        "plan.png",
        "plan.yaml",
        "plan.tif",
        "section.png",
        "ground.tif",
        "top.tif",
    ]
    .map(|name| folder.text(name));
    for out in [&png, &pgm, &tif] {
        tsdfuse(&["map", "slice", &map, "--height", "1.0", "-o", out]).succeeded();
    }
    let grid = std::fs::read(folder.path("plan.pgm")).unwrap();
    let count = |cell: u8| grid.iter().filter(|byte| **byte == cell).count();
    assert!(count(0) > 100 && count(100) > 100 && count(255) > 1000);
    let yaml = std::fs::read_to_string(folder.path("plan.yaml")).unwrap();
    assert!(
        yaml.contains("image: \"plan.pgm\"") && yaml.contains("resolution: 0.2"),
        "{yaml}"
    );
    tsdfuse(&[
        "map", "section", &map, "--from", "5,-12", "--to", "5,12", "-o", &section,
    ])
    .succeeded();
    let terrain = [
        "map",
        "terrain",
        &map,
        "-o",
        &ground,
        "--surface",
        &top,
        "--epsg",
        "32632",
    ];
    tsdfuse(&terrain).succeeded();
    for file in [&png, &section] {
        assert!(std::fs::read(file).unwrap().starts_with(b"\x89PNG"));
    }
    for file in [&tif, &ground, &top] {
        assert!(std::fs::read(file).unwrap().starts_with(b"II*\0"));
    }
    let told = |more: &[&str], code| tsdfuse(&[&["map"][..], more].concat()).failed(code);
    assert!(told(&["slice", &map, "--height", "900", "-o", &png], 1).contains("nothing was observed there"));
    assert!(told(&["slice", &map, "--height", "1", "-o", "a.jpg"], 2).contains("as .png, .yaml or .tif"));
    assert!(told(&["section", &map, "--from", "1,1", "--to", "1,1", "-o", &section], 2).contains("are one place"));
    assert!(told(&["terrain", &map, "-o", &png], 2).contains("heights are written as .tif"));
}
