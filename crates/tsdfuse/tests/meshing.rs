//! A growing map, meshed piece by piece, against the whole map meshed anew.

#![allow(clippy::unwrap_used)]

mod common;

use std::collections::{BTreeMap, BTreeSet};

use tsdfuse::{
    Integrator, MapConfig, Raycast, Scan, VoxelMap,
    glam::{DVec3, Vec3},
    index::BlockIndex,
    mesh::{Changes, Incremental, Mesh, MeshConfig, Nearby, extract_with},
};

/// Position and normal of the three corners of a triangle, bit for bit.
type Triangle = [([u64; 3], [u32; 3]); 3];

fn triangles(vertices: &[DVec3], normals: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Triangle> {
    let corner = |v: u32| {
        let (position, normal) = (vertices[v as usize], normals[v as usize]);
        (
            position.to_array().map(f64::to_bits),
            normal.to_array().map(f32::to_bits),
        )
    };
    triangles.iter().map(|t| t.map(corner)).collect()
}

/// What someone shows who only hears of changes.
#[derive(Default)]
struct Viewer {
    pieces: BTreeMap<BlockIndex, Vec<Triangle>>,
    gained: usize,
    lost: usize,
}

impl Viewer {
    fn hear(&mut self, changes: &Changes, listens: impl Fn(BlockIndex) -> bool) {
        assert!(changes.iter().map(|piece| piece.block).is_sorted_by(|a, b| a < b));
        for piece in changes.iter().filter(|piece| listens(piece.block)) {
            let used: BTreeSet<u32> = piece.triangles.iter().flatten().copied().collect();
            assert!(used.into_iter().eq(0..piece.vertices.len() as u32), "no vertex is idle");
            let old = if piece.triangles.is_empty() {
                self.pieces.remove(&piece.block)
            } else {
                let shown = triangles(piece.vertices, piece.normals, piece.triangles);
                self.pieces.insert(piece.block, shown)
            };
            self.gained += usize::from(old.is_none());
            self.lost += usize::from(piece.triangles.is_empty());
        }
    }

    fn shows(&self, mesh: &Mesh) -> bool {
        let all = triangles(&mesh.vertices, &mesh.normals, &mesh.triangles);
        self.pieces.values().flatten().eq(&all)
    }
}

/// A wall that comes nearer, while the sensor moves sideways along it.
fn moving_wall(number: usize) -> Scan {
    let (n, mut scan) = (number as f64, common::scan(0, 0));
    scan.pose.as_mut().unwrap().rotation = Default::default();
    scan.pose.as_mut().unwrap().translation = DVec3::new(0.01 * n, 0.15 * n, -0.02 * n);
    let grid = (-25..=25).flat_map(|y| (-25..=25).map(move |z| (0.03 * f64::from(y), 0.03 * f64::from(z))));
    scan.points = grid
        .map(|(y, z)| Vec3::new((2.0 - 0.04 * n + 0.1 * y) as f32, y as f32, z as f32))
        .collect();
    scan
}

struct Case {
    scans: Vec<Scan>,
    map: MapConfig,
    min_weight: f32,
    /// After how many scans the pieces are asked for.
    every: usize,
}

fn cases() -> [Case; 4] {
    let room = |rays| (0..8).map(|n| common::scan(n, rays)).collect::<Vec<_>>();
    let forgetful = MapConfig {
        max_weight: 0.3,
        ..Default::default()
    };
    let wall = || (0..16).map(moving_wall).collect::<Vec<_>>();
    let case = |scans, map, min_weight, every| Case {
        scans,
        map,
        min_weight,
        every,
    };
    [
        case(room(20_000), MapConfig::default(), 0.0, 1),
        case(room(6_000), MapConfig::default(), 0.5, 1),
        case(wall(), forgetful, 0.0, 1),
        case(wall(), forgetful, 0.2, 3),
    ]
}

/// Follows a case; `listens` to pieces of updated blocks, and of others.
fn follow(case: &Case, listens_to_others: bool) -> (Viewer, usize) {
    let config = MeshConfig {
        min_weight: case.min_weight,
    };
    let mut map = VoxelMap::new(case.map).unwrap();
    let (mut raycast, mut surface, mut viewer) = (Raycast::default(), Incremental::new(&config), Viewer::default());
    let (mut updated, mut wrong, mut changes) = (BTreeSet::new(), 0, Changes::default());
    for (number, scan) in case.scans.iter().enumerate() {
        let blocks = raycast.integrate(&mut map, scan).unwrap().updated_blocks;
        surface.note(&blocks);
        updated.extend(blocks);
        let whole = extract_with(&map, &config).unwrap();
        assert!(surface.mesh(&map).unwrap() == whole, "scan {number}");
        if (number + 1) % case.every == 0 {
            surface.changes(&map, &mut changes);
            viewer.hear(&changes, |block| listens_to_others || updated.contains(&block));
            wrong += usize::from(!viewer.shows(&whole));
            updated.clear();
            surface.changes(&map, &mut changes);
            assert!(changes.is_empty());
        }
    }
    assert!(surface.memory_bytes() < 300 * map.block_count() + 100_000);
    (viewer, wrong)
}

#[test]
fn pieces_and_the_whole_are_those_of_the_map_at_any_time() {
    let (mut gained, mut lost) = (0, 0);
    for (number, case) in cases().iter().enumerate() {
        let (viewer, wrong) = follow(case, true);
        assert_eq!(wrong, 0, "case {number}");
        gained += viewer.gained;
        lost += viewer.lost;
    }
    assert!(gained > 500 && lost > 20, "{gained} {lost}");
}

#[test]
fn a_neighbours_update_that_is_not_taken_up_is_seen() {
    // Where scans update all of the surface, no neighbour is left.
    let wrong = cases().map(|case| follow(&case, false).1);
    assert!(wrong.iter().filter(|&&wrong| wrong > 0).count() > 1, "{wrong:?}");
}

#[test]
fn what_is_near_is_told_at_once_and_the_rest_in_turns() {
    let mut late = [0; 2];
    for case in &cases() {
        let config = MeshConfig {
            min_weight: case.min_weight,
        };
        for (place, late) in [DVec3::ZERO, DVec3::new(0.0, 0.0, 500.0)].into_iter().zip(&mut late) {
            let mut map = VoxelMap::new(case.map).unwrap();
            let (mut raycast, mut surface) = (Raycast::default(), Incremental::new(&config));
            let (mut viewer, mut changes, mut nearby) = (Viewer::default(), Changes::default(), Nearby::new(50.0));
            let mut tell = |surface: &mut Incremental, map: &VoxelMap| {
                nearby.move_to(place);
                surface.changes_near(map, &nearby, &mut changes);
                viewer.hear(&changes, |_| true);
                viewer.shows(&extract_with(map, &config).unwrap())
            };
            for scan in &case.scans {
                surface.note(&raycast.integrate(&mut map, scan).unwrap().updated_blocks);
                *late += usize::from(!tell(&mut surface, &map));
            }
            let shows = (0..10).map(|_| tell(&mut surface, &map)).last();
            assert_eq!(shows, Some(true));
            surface.changes(&map, &mut changes);
            assert!(changes.is_empty());
        }
    }
    assert!(late[0] == 0 && late[1] > 20, "{late:?}");
}

#[test]
fn a_map_that_is_there_already_is_noted_at_once() {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    Raycast::default()
        .integrate(&mut map, &common::scan(1, 20_000))
        .unwrap();
    let (mut surface, mut viewer) = (Incremental::default(), Viewer::default());
    surface.note(&map.block_indices());
    let mut changes = Changes::default();
    surface.changes(&map, &mut changes);
    viewer.hear(&changes, |_| true);
    assert!(viewer.shows(&extract_with(&map, &MeshConfig::default()).unwrap()));
}

#[test]
fn any_number_of_threads_gives_the_same_pieces() {
    let pieces = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut map = VoxelMap::new(MapConfig::default()).unwrap();
            let (mut raycast, mut surface) = (Raycast::default(), Incremental::default());
            let (mut all, mut changes) = (Vec::new(), Changes::default());
            for number in 0..3 {
                surface.note(
                    &raycast
                        .integrate(&mut map, &common::scan(number, 20_000))
                        .unwrap()
                        .updated_blocks,
                );
                surface.changes(&map, &mut changes);
                all.extend(
                    changes
                        .iter()
                        .map(|p| (p.block, p.vertices.to_vec(), p.normals.to_vec(), p.triangles.to_vec())),
                );
            }
            all
        })
    };
    let one = pieces(1);
    assert!(one == pieces(4) && one.len() > 300);
}
