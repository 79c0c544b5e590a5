use std::io::{Read, Write};
use std::net::TcpStream;

use serde_json::Value;
use tsdfuse::{Integrator, MapConfig, Mesh, Pose, Raycast, Scan, VoxelMap, mesh::Incremental};
use tungstenite::{Message, WebSocket, client};

use super::*;
use crate::pack::tests::unpack;

const ANY_PORT: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// A viewer that keeps what it is told.
struct Viewer {
    socket: WebSocket<TcpStream>,
    pieces: std::collections::BTreeMap<[i64; 3], Piece>,
    told: usize,
    answer: &'static str,
}

impl Viewer {
    fn of(live: &Live) -> Self {
        let stream = TcpStream::connect(live.address()).unwrap();
        let url = live.url().replace("http", "ws") + "live";
        let (socket, _) = client(url, stream).unwrap();
        Self {
            socket,
            pieces: Default::default(),
            told: 0,
            answer: "ok",
        }
    }

    /// Takes one message and answers it.
    fn take(&mut self) -> Value {
        let Message::Binary(bytes) = self.socket.read().unwrap() else {
            panic!("bytes are wanted")
        };
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let head: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        let mut at = 4 + length;
        for piece in head["pieces"].as_array().unwrap() {
            let [x, y, z, size] = [0, 1, 2, 3].map(|i| piece[i].as_i64().unwrap());
            self.told += 1;
            match size {
                0 => self.pieces.remove(&[x, y, z]),
                _ => self.pieces.insert([x, y, z], unpack(&bytes[at..][..size as usize], 0)),
            };
            at += size as usize;
        }
        assert_eq!(at + head["sweep"].as_u64().unwrap_or_default() as usize, bytes.len());
        self.socket.send(Message::text(self.answer)).unwrap();
        head
    }

    fn triangles(&self) -> usize {
        self.pieces.values().map(|piece| piece.triangles.len()).sum()
    }
}

/// A wall at a distance.
fn wall(x: f32) -> Scan {
    let points = (-60..=60).flat_map(|y| (-60..=60).map(move |z| Vec3::new(x, 0.02 * y as f32, 0.02 * z as f32)));
    Scan {
        points: points.collect(),
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}

#[test]
fn viewers_are_told_what_changed_and_late_ones_all() {
    let live = Live::serve(ANY_PORT, "a wall").unwrap();
    let mut first = Viewer::of(&live);
    assert_eq!(first.take()["scene"]["title"], "a wall");
    let config = MapConfig::default();
    live.begin(DVec3::ZERO, config.voxel_size_m);
    let (mut map, mut raycast) = (VoxelMap::new(config).unwrap(), Raycast::default());
    let (mut surface, mut changes) = (Incremental::default(), Changes::default());
    let mut told = Vec::new();
    for x in [2.0, 2.02, 3.0] {
        surface.note(&raycast.integrate(&mut map, &wall(x)).unwrap().updated_blocks);
        surface.changes(&map, &mut changes);
        live.changes(&changes);
        live.scan(Some(DVec3::X), 0.1);
        let whole = surface.mesh(&map).unwrap().triangles.len();
        let before = first.told;
        while first.told == before || first.triangles() != whole {
            first.take();
        }
        told.push(first.told - before);
    }
    assert!(told.iter().all(|&pieces| pieces > 0), "{told:?}");
    let mut late = Viewer::of(&live);
    let head = late.take();
    assert_eq!(
        (
            head["path"].as_array().unwrap().len(),
            head["seconds"].as_array().unwrap().len()
        ),
        (9, 3)
    );
    while head["more"] == true && late.triangles() != first.triangles() {
        late.take();
    }
    assert!(late.pieces == first.pieces);
    // What changed again meanwhile is told once.
    assert!(late.told < first.told, "{} {}", late.told, first.told);
    // Vertices are where they were, within a step.
    let lattice = live.shared.look(State::lattice).unwrap();
    let mut heights: Vec<f64> = Vec::new();
    for piece in late.pieces.values() {
        heights.extend(
            piece
                .positions
                .iter()
                .map(|p| f64::from(piece.origin.x + i32::from(p[0])) * lattice.step_m),
        );
    }
    let mesh = surface.mesh(&map).unwrap();
    let least = mesh.vertices.iter().map(|v| v.x).fold(f64::MAX, f64::min);
    assert!((heights.into_iter().fold(f64::MAX, f64::min) - least).abs() <= lattice.step_m);
}

#[test]
fn a_viewer_that_asks_for_more_is_told_all_in_fewer_messages() {
    let live = Live::serve(ANY_PORT, "").unwrap();
    let config = MapConfig {
        voxel_size_m: 0.02,
        truncation_m: 0.08,
        ..MapConfig::default()
    };
    live.begin(DVec3::ZERO, config.voxel_size_m);
    let (mut map, mut raycast) = (VoxelMap::new(config).unwrap(), Raycast::default());
    let (mut surface, mut changes) = (Incremental::default(), Changes::default());
    for x in (2..16).step_by(2) {
        let scan = wall(x as f32);
        surface.note(&raycast.integrate(&mut map, &scan).unwrap().updated_blocks);
    }
    surface.changes(&map, &mut changes);
    live.changes(&changes);
    let messages = |answer| {
        let mut viewer = Viewer::of(&live);
        viewer.answer = answer;
        let mut count = 1;
        while viewer.take()["more"] == true {
            count += 1;
        }
        (count, viewer.triangles())
    };
    let ((few, all), (many, same), (garbled, _)) = (messages("ok 16"), messages("ok"), messages("ok -1x"));
    assert!(all == same && all > 10_000, "{all} {same}");
    assert!(few == 2 && many > 3 && garbled == many, "{few} {many} {garbled}");
}

#[test]
fn closed_loops_are_told_once() {
    let live = Live::serve(ANY_PORT, "").unwrap();
    live.begin(DVec3::ZERO, 0.05);
    let mut viewer = Viewer::of(&live);
    viewer.take();
    live.loops(&[[DVec3::X, DVec3::Y], [DVec3::Z, DVec3::X]]);
    let head = viewer.take();
    assert_eq!(
        head["loops"],
        serde_json::json!([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    );
    live.path(&[DVec3::X]);
    assert!(viewer.take().get("loops").is_none());
}

#[test]
fn a_path_that_changed_is_told_anew() {
    let live = Live::serve(ANY_PORT, "").unwrap();
    live.begin(DVec3::ZERO, 0.05);
    let mut viewer = Viewer::of(&live);
    viewer.take();
    live.path(&[DVec3::X, DVec3::Y]);
    let head = viewer.take();
    assert_eq!(
        (head["path_from"].as_u64(), head["path"].as_array().unwrap().len()),
        (Some(0), 6)
    );
    live.path(&[DVec3::X, DVec3::Y, DVec3::Z]);
    let head = viewer.take();
    assert_eq!(
        (head["path_from"].as_u64(), head["path"].as_array().unwrap().len()),
        (Some(2), 3)
    );
    live.path(&[DVec3::Z, DVec3::Y, DVec3::Z]);
    let head = viewer.take();
    assert_eq!(
        (head["path_from"].as_u64(), head["path"].as_array().unwrap().len()),
        (Some(0), 9)
    );
}

/// The status line and the body of an answer.
fn get(live: &Live, path: &str) -> (String, String) {
    let mut stream = TcpStream::connect(live.address()).unwrap();
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    )
    .unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap().to_owned(), body.to_owned())
}

#[test]
fn only_who_knows_the_token_is_told_anything_and_no_file_beyond_the_tiles() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("tiles")).unwrap();
    std::fs::write(dir.path().join("secret.json"), "secret").unwrap();
    std::fs::write(dir.path().join("tiles/tileset.json"), "{}").unwrap();
    let live = Live::serve_tiles(ANY_PORT, "tiles", dir.path().join("tiles/tileset.json")).unwrap();
    assert!(live.address().ip().is_loopback());
    let path = live.url().replace(&format!("http://{}", live.address()), "");
    assert_eq!(path.len(), 34);
    let (status, page) = get(&live, &path);
    assert!(
        status.contains("200") && page.contains("tiles/tileset.json"),
        "{status}"
    );
    assert!(get(&live, &format!("{path}tiles/tileset.json")).0.contains("200"));
    for wrong in ["/", "/live", "/00000000000000000000000000000000/", &path[..20]] {
        let (status, page) = get(&live, wrong);
        assert!(status.contains("403") && !page.contains("tileset"), "{wrong}: {status}");
    }
    for wrong in [
        "tiles/../secret.json",
        "tiles/%2e%2e/secret.json",
        "tiles//etc/passwd",
        "tiles/nothing.glb",
        "elsewhere",
    ] {
        let (status, page) = get(&live, &format!("{path}{wrong}"));
        assert!(status.contains("404") && !page.contains("secret"), "{wrong}: {status}");
    }
    assert!(get(&live, &format!("{path}live")).0.contains("400"));
}

#[test]
fn a_whole_surface_is_shown_and_viewers_that_are_gone_are_forgotten() {
    let live = Live::serve(ANY_PORT, "").unwrap();
    let mesh = Mesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
        normals: vec![Vec3::Z; 3],
        triangles: vec![[0, 1, 2]],
    };
    live.show(&Scene::default(), &Surface::of(&mesh));
    let mut viewer = Viewer::of(&live);
    assert_eq!(viewer.take()["scene"]["ended"], true);
    assert_eq!((viewer.triangles(), live.viewers()), (1, 1));
    drop(viewer);
    for _ in 0..100 {
        live.figures(vec![("a".into(), "b".into())]);
        std::thread::sleep(std::time::Duration::from_millis(20));
        if live.viewers() == 0 {
            return;
        }
    }
    panic!("the viewer is still counted");
}
