//! Maps that are fused with little memory, and what a store holds after a crash.

#![allow(clippy::unwrap_used)] // test helpers

use std::path::Path;

use tsdfuse::fuse::{FuseConfig, Method};
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::Block;
use tsdfuse::mesh::{MeshConfig, extract_with};
use tsdfuse::scan::RangeLimits;
use tsdfuse::{MapConfig, Mesh, Scan, SensorModel, VoxelMap};
use tsdfuse_sim::{NoiseModel, Simulator, SimulatorConfig, path, scene};
use tsdfuse_store::{Options, Pager, Sink};

const LITTLE: Options = Options { limit_bytes: 1 << 20 };

fn config() -> MapConfig {
    MapConfig {
        voxel_size_m: 0.05,
        truncation_m: 0.2,
        max_weight: 5.0,
    }
}

/// A drive through a street and back, by a sensor that sees as far as a lamp.
fn drive() -> (SensorModel, Vec<Scan>) {
    let street = scene::by_name("street", 3).unwrap();
    let sensor = tsdfuse::sensor::model("vlp16").unwrap();
    let config = SimulatorConfig {
        noise: NoiseModel::none(),
        ..Default::default()
    };
    let poses = path::default_for(&street, 24);
    let simulator = Simulator::new(street, sensor.clone(), poses, config).unwrap();
    let mut scans: Vec<Scan> = simulator.scans().collect();
    for scan in &mut scans {
        scan.drop_invalid(&RangeLimits {
            min_range_m: 0.5,
            max_range_m: 7.0,
        });
    }
    let back: Vec<Scan> = scans.iter().rev().cloned().collect();
    scans.extend(back);
    (sensor, scans)
}

/// Fuses scans with the whole map in memory.
fn fused(method: Method, sensor: &SensorModel, scans: &[Scan]) -> VoxelMap {
    let mut map = VoxelMap::new(config()).unwrap();
    let mut integrator = method.build(&FuseConfig::default(), Some(sensor));
    for scan in scans {
        integrator.integrate(&mut map, scan).unwrap();
    }
    map
}

/// Fuses scans with little of the map in memory, commits after some of them (counted from 1), and tells how often something was taken out.
fn fused_with_little(
    (map, pager): &mut (VoxelMap, Pager),
    method: Method,
    sensor: &SensorModel,
    scans: &[Scan],
    commits: &[usize],
) -> usize {
    let options = FuseConfig::default();
    let mut integrator = method.build(&options, Some(sensor));
    let mut taken = 0;
    for (number, scan) in (1..).zip(scans) {
        pager
            .bring(map, &method.reach(&options, map.config(), scan).unwrap())
            .unwrap();
        if let Some(next) = scans.get(number) {
            pager
                .expect(map, &method.reach(&options, map.config(), next).unwrap())
                .unwrap();
        }
        let done = integrator.integrate(map, scan).unwrap();
        pager.note(map, &done.updated_blocks).unwrap();
        let before = map.block_count();
        pager.release(map).unwrap();
        taken += usize::from(map.block_count() < before);
        if commits.contains(&number) {
            pager.commit(map, number.to_string().as_bytes()).unwrap();
        }
    }
    taken
}

fn new_store(path: &Path) -> (VoxelMap, Pager) {
    let map = VoxelMap::new(config()).unwrap();
    let pager = Pager::create(path, &map, b"new", LITTLE).unwrap();
    (map, pager)
}

/// All of a map, in memory.
fn whole((mut map, mut pager): (VoxelMap, Pager)) -> VoxelMap {
    let all = pager.regions();
    pager.bring_all(&mut map, &all).unwrap();
    map
}

#[test]
fn little_memory_makes_no_difference_to_any_bit() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, scans) = drive();
    for &method in Method::ALL.iter().filter(|m| **m != Method::Depth) {
        let expected = fused(method, &sensor, &scans);
        let mut paged = new_store(&dir.path().join(method.name()));
        let taken = fused_with_little(&mut paged, method, &sensor, &scans, &[20]);
        let most = paged.1.most_bytes();
        assert!(
            taken > 5 && most < expected.memory_bytes(),
            "{method:?}: {taken} {most}"
        );
        let integrations = paged.0.integrations();
        let map = whole(paged);
        assert!(map == expected && integrations == expected.integrations(), "{method:?}");
    }
    // The comparison would see a scan less.
    let of = |scans: &[Scan]| fused(Method::Raycast, &sensor, scans);
    assert!(of(&scans) != of(&scans[1..]));
}

#[test]
fn what_was_committed_is_there_and_nothing_later() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, scans) = drive();
    let path = dir.path().join("a.store");
    let method = Method::Patch;
    let reopened = || {
        let (map, pager, note) = Pager::open(&path, LITTLE).unwrap();
        (map, pager, String::from_utf8(note).unwrap())
    };
    drop(new_store(&path));
    assert_eq!(reopened().2, "new");
    let (map, pager, _) = reopened();
    let mut paged = (map, pager);
    // Scans after the last commit are lost with the process, though some of their blocks were written.
    assert!(fused_with_little(&mut paged, method, &sensor, &scans[..40], &[10, 30]) > 5);
    drop(paged);
    let (map, pager, note) = reopened();
    assert_eq!((note.as_str(), map.integrations()), ("30", 30));
    assert_eq!(map.block_count(), 0);
    let sizes = pager.sizes();
    let map = whole((map, pager));
    let expected = fused(method, &sensor, &scans[..30]);
    assert!(map == expected && map != fused(method, &sensor, &scans[..31]));
    assert_eq!(sizes.blocks as usize, expected.block_count());
    assert_eq!(sizes.observed_voxels as usize, expected.observed_voxel_count());
    // And the run goes on from there.
    let (map, pager, _) = reopened();
    let mut paged = (map, pager);
    fused_with_little(&mut paged, method, &sensor, &scans[30..], &[]);
    assert!(whole(paged) == fused(method, &sensor, &scans));
}

/// Keeps a mesh.
#[derive(Default)]
struct Kept(Mesh);

impl Sink for Kept {
    fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> std::io::Result<()> {
        self.0.vertices.extend(positions);
        self.0.normals.extend(normals);
        Ok(())
    }

    fn triangles(&mut self, triangles: &[[u32; 3]]) -> std::io::Result<()> {
        self.0.triangles.extend(triangles);
        Ok(())
    }
}

/// Triangles as positions and normals, in an order of their own.
fn triangles(mesh: &Mesh) -> Vec<[[u64; 6]; 3]> {
    let corner = |v: u32| {
        let (p, n) = (mesh.vertices[v as usize], mesh.normals[v as usize].as_dvec3());
        [p.x, p.y, p.z, n.x, n.y, n.z].map(f64::to_bits)
    };
    let mut all: Vec<_> = mesh.triangles.iter().map(|t| t.map(corner)).collect();
    all.sort_unstable();
    all
}

#[test]
fn the_mesh_of_a_map_in_parts_is_that_of_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, mut scans) = drive();
    // Also far away, where coordinates have many digits.
    for (name, offset) in [
        ("near", DVec3::ZERO),
        ("far", DVec3::new(691_000.0, 5_335_000.0, 520.0)),
    ] {
        scans
            .iter_mut()
            .for_each(|scan| scan.pose.as_mut().unwrap().translation += offset);
        let mut paged = new_store(&dir.path().join(name));
        fused_with_little(&mut paged, Method::Raycast, &sensor, &scans, &[scans.len()]);
        let expected = fused(Method::Raycast, &sensor, &scans);
        for min_weight in [0.0, 0.3] {
            let config = MeshConfig { min_weight };
            let (map, pager) = &mut paged;
            let mut kept = Kept::default();
            pager.mesh(map, &config, &mut kept).unwrap();
            let whole = extract_with(&expected, &config).unwrap();
            assert!(whole.triangles.len() > 10_000);
            assert_eq!(kept.0.vertices.len(), whole.vertices.len());
            assert!(triangles(&kept.0) == triangles(&whole), "{name} {min_weight}");
            assert_eq!(kept.0.topology(), whole.topology());
            assert!(map.block_count() < expected.block_count());
        }
    }
}

#[test]
fn what_is_touched_unasked_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let (mut map, mut pager) = new_store(&path);
    let block = BlockIndex(IVec3::new(3, 4, 5));
    map.insert_block(block, Block::EMPTY).unwrap();
    pager.note(&map, &[block]).unwrap();
    pager.commit(&mut map, b"").unwrap();
    drop(pager);
    let (map, mut pager, _) = Pager::open(&path, LITTLE).unwrap();
    assert_eq!(pager.regions(), [RegionIndex(IVec3::ZERO)]);
    let told = pager.note(&map, &[block]).unwrap_err().to_string();
    assert!(
        told.ends_with("a.store: region [0, 0, 0] was touched although it lies beyond the scan's reach"),
        "{told}"
    );
}

#[test]
fn stores_that_are_none_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let open = || Pager::open(&path, LITTLE).map(drop).unwrap_err().to_string();
    assert!(open().contains("a.store: No such file"), "{}", open());
    std::fs::write(&path, vec![7; 10_000]).unwrap();
    let told = open();
    assert!(told.contains("a.store: ") && told.lines().count() == 1, "{told}");
    let map = VoxelMap::new(config()).unwrap();
    let told = Pager::create(&path, &map, b"", LITTLE)
        .map(drop)
        .unwrap_err()
        .to_string();
    assert!(told.ends_with("a.store: is there already"), "{told}");
    let told = Pager::create(dir.path().join("no/a.store"), &map, b"", LITTLE)
        .map(drop)
        .unwrap_err()
        .to_string();
    assert!(told.contains("no/a.store: No such file"), "{told}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn flipped_bytes_are_told_or_do_not_matter() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, scans) = drive();
    let path = dir.path().join("a.store");
    let mut paged = new_store(&path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..6], &[6]);
    drop(paged);
    let expected = fused(Method::Raycast, &sensor, &scans[..6]);
    let bytes = std::fs::read(&path).unwrap();
    let mut told = 0;
    for place in 1..40 {
        let mut flipped = bytes.clone();
        flipped[bytes.len() / 40 * place + 100] ^= 0x20;
        std::fs::write(&path, &flipped).unwrap();
        let read = Pager::open(&path, LITTLE).and_then(|(mut map, mut pager, _)| {
            let all = pager.regions();
            pager.bring_all(&mut map, &all)?;
            Ok(map)
        });
        match read {
            Ok(map) => assert!(map == expected),
            Err(error) => {
                assert_eq!(error.to_string().lines().count(), 1);
                told += 1;
            }
        }
    }
    assert!(told > 0);
}
