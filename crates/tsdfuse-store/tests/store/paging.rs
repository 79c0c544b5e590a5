//! The same map with little memory, and after a crash.

use tsdfuse::fuse::{FuseConfig, FuseError, Method};
use tsdfuse::glam::{DVec3, IVec3, Vec3};
use tsdfuse::index::{BlockIndex, RegionIndex};
use tsdfuse::map::Block;
use tsdfuse::mesh::{MeshConfig, MeshSink, extract_with};
use tsdfuse::{Integration, Integrator, MapConfig, Mesh, Pose, Reach, Scan, VoxelMap};
use tsdfuse_io::map_file::FusedPose;
use tsdfuse_store::{OverLimit, PagedError, PagedMap, Salvage, StoreError};

use super::{LITTLE, config, drive, fused, fused_with_little, new_store, whole};

#[test]
fn little_memory_makes_no_difference_to_any_bit() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, scans) = drive();
    for &method in Method::ALL.iter().filter(|m| **m != Method::Depth) {
        let expected = fused(method, &sensor, &scans);
        let mut paged = new_store(&dir.path().join(method.name()));
        let evicted = fused_with_little(&mut paged, method, &sensor, &scans, &[20]);
        let most = paged.most_bytes();
        assert!(
            evicted > 5 && most < expected.memory_bytes(),
            "{method:?}: {evicted} {most}"
        );
        let integrations = paged.integrations();
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
        let (paged, checkpoint) = PagedMap::open(&path, LITTLE).unwrap();
        (paged, String::from_utf8(checkpoint).unwrap())
    };
    drop(new_store(&path));
    assert_eq!(reopened().1, "new");
    let (mut paged, _) = reopened();
    // Scans after the last commit are lost with the process, though some of their blocks were written.
    assert!(fused_with_little(&mut paged, method, &sensor, &scans[..40], &[10, 30]) > 5);
    drop(paged);
    let (paged, checkpoint) = reopened();
    assert_eq!((checkpoint.as_str(), paged.integrations()), ("30", 30));
    assert_eq!(paged.map_in_memory().block_count(), 0);
    let sizes = paged.sizes();
    let map = whole(paged);
    let expected = fused(method, &sensor, &scans[..30]);
    assert!(map == expected && map != fused(method, &sensor, &scans[..31]));
    assert_eq!(sizes.blocks as usize, expected.block_count());
    assert_eq!(sizes.observed_voxels as usize, expected.observed_voxel_count());
    // And the run goes on from there.
    let (mut paged, _) = reopened();
    fused_with_little(&mut paged, method, &sensor, &scans[30..], &[]);
    assert!(whole(paged) == fused(method, &sensor, &scans));
}

#[test]
fn poses_are_committed_with_the_map() {
    let dir = tempfile::tempdir().unwrap();
    let (path, saved) = (dir.path().join("a.store"), dir.path().join("a.tsdf"));
    let pose = |number: u32| FusedPose {
        time_ns: (number > 2).then_some(i64::from(number)),
        pose: Pose {
            translation: DVec3::X * f64::from(number),
            ..Pose::IDENTITY
        },
    };
    let poses: Vec<FusedPose> = (0..9).map(pose).collect();
    let mut paged = new_store(&path);
    for some in poses[..6].chunks(2) {
        paged.add_poses(some);
        paged.commit(b"").unwrap();
    }
    paged.add_poses(&poses[6..]);
    paged.save(&saved).unwrap();
    assert_eq!(tsdfuse_io::map_file::read_with_poses(&saved).unwrap().1, poses);
    drop(paged);
    assert_eq!(Salvage::scan(&path).unwrap().poses(), &poses[..6]);
    let (mut paged, _) = PagedMap::open(&path, LITTLE).unwrap();
    assert_eq!(paged.poses(), &poses[..6]);
    paged.add_poses(&poses[6..]);
    paged.commit(b"").unwrap();
    drop(paged);
    assert_eq!(PagedMap::open_read_only(&path, LITTLE).unwrap().0.poses(), poses);
}

/// Keeps a mesh.
#[derive(Default)]
struct Kept(Mesh);

impl MeshSink for Kept {
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
            let mut kept = Kept::default();
            paged.mesh(&config, &mut kept).unwrap();
            let whole = extract_with(&expected, &config).unwrap();
            assert!(whole.triangles.len() > 10_000);
            assert_eq!(kept.0.vertices.len(), whole.vertices.len());
            assert!(triangles(&kept.0) == triangles(&whole), "{name} {min_weight}");
            assert_eq!(kept.0.topology(), whole.topology());
            assert!(paged.map_in_memory().block_count() < expected.block_count());
        }
    }
}

/// Changes one block, which it says to be within its reach or not.
struct Pokes {
    block: BlockIndex,
    is_honest: bool,
}

impl Integrator for Pokes {
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        if scan.points.is_empty() {
            return Err(FuseError::Config("no points".to_owned()));
        }
        // It may be there.
        let _ = map.insert_block(self.block, Block::EMPTY);
        Ok(Integration {
            updated_blocks: vec![self.block],
            ..Default::default()
        })
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        let reach = Reach::of(map, scan)?;
        Ok(if self.is_honest {
            reach
        } else {
            reach.at(DVec3::splat(1e6))
        })
    }

    fn needs_sensor(&self) -> bool {
        false
    }
}

fn a_scan() -> Scan {
    Scan {
        points: vec![Vec3::X],
        pose: Some(Pose::IDENTITY),
        ..Default::default()
    }
}

#[test]
fn what_is_touched_unasked_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let mut pokes = Pokes {
        block: BlockIndex(IVec3::new(3, 4, 5)),
        is_honest: true,
    };
    let mut paged = new_store(&path);
    paged.integrate(&mut pokes, &a_scan()).unwrap();
    paged.commit(b"good").unwrap();
    drop(paged);
    let (mut paged, _) = PagedMap::open(&path, LITTLE).unwrap();
    assert_eq!(paged.regions(), [RegionIndex(IVec3::ZERO)]);
    paged.integrate(&mut pokes, &a_scan()).unwrap();
    drop(paged);

    let (mut paged, _) = PagedMap::open(&path, LITTLE).unwrap();
    pokes.is_honest = false;
    let told = paged.integrate(&mut pokes, &a_scan()).unwrap_err();
    assert!(
        matches!(told, PagedError::Store(StoreError::BeyondReach { .. })),
        "{told}"
    );
    let told = told.to_string();
    assert!(
        told.ends_with("a.store: region [0, 0, 0] was touched although it lies beyond the scan's reach"),
        "{told}"
    );
    // The map is not to be trusted any more, whoever asks.
    let broken = |error: StoreError| {
        let is_broken = matches!(error, StoreError::Broken { .. });
        assert!(is_broken && error.to_string().starts_with(&told), "{error}");
    };
    match paged.integrate(&mut pokes, &a_scan()).unwrap_err() {
        PagedError::Store(error) => broken(error),
        PagedError::Fuse(error) => panic!("{error}"),
    }
    broken(paged.commit(b"bad").unwrap_err());
    broken(paged.mesh(&MeshConfig::default(), &mut Kept::default()).unwrap_err());
    broken(paged.for_each_region(|_, _| Ok(())).unwrap_err());
    broken(paged.save(dir.path().join("a.tsdf")).unwrap_err());
    broken(paged.put_block(pokes.block, Block::EMPTY).unwrap_err());
    drop(paged);
    assert_eq!(PagedMap::open(&path, LITTLE).unwrap().1, b"good");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn a_bad_scan_leaves_the_map_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, scans) = drive();
    let mut paged = new_store(&dir.path().join("a.store"));
    let mut method = Method::Raycast.build(&FuseConfig::default(), Some(&sensor));
    for (number, scan) in scans.iter().take(8).enumerate() {
        paged.integrate(&mut *method, scan).unwrap();
        let bad = match number % 2 {
            // Neither its reach nor the fusing of it.
            0 => Scan {
                times: Some(vec![0.0; 3]),
                ..scan.clone()
            },
            _ => Scan {
                points: Vec::new(),
                ..a_scan()
            },
        };
        let mut pokes = Pokes {
            block: BlockIndex(IVec3::ZERO),
            is_honest: true,
        };
        let told = match number % 2 {
            0 => paged.integrate(&mut *method, &bad),
            _ => paged.integrate(&mut pokes, &bad),
        };
        assert!(matches!(told, Err(PagedError::Fuse(_))), "{told:?}");
    }
    assert!(whole(paged) == fused(Method::Raycast, &sensor, &scans[..8]));
}

#[test]
fn blocks_are_put_in_with_little_memory() {
    let dir = tempfile::tempdir().unwrap();
    let (sensor, scans) = drive();
    let map = fused(Method::Raycast, &sensor, &scans[..24]);
    let mut paged = new_store(&dir.path().join("a.store"));
    let blocks = map.regions().into_iter().flat_map(|region| {
        let blocks = map.blocks_of(region);
        blocks.map(|(index, block)| (index, block.clone())).collect::<Vec<_>>()
    });
    assert_eq!(paged.put_blocks(blocks).unwrap(), map.block_count());
    assert!(paged.most_bytes() < map.memory_bytes());
    let index = map.block_indices()[0];
    let told = paged.put_block(index, Block::EMPTY).unwrap_err().to_string();
    assert!(
        told.contains("a.store: block ") && told.ends_with(" is there already"),
        "{told}"
    );
    // A block that is refused does no harm.
    paged.set_integrations(map.integrations());
    let saved = dir.path().join("a.tsdf");
    paged.save(&saved).unwrap();
    let (saved, expected) = (std::fs::read(saved).unwrap(), dir.path().join("b.tsdf"));
    tsdfuse_io::map_file::write(&expected, &map).unwrap();
    assert!(saved == std::fs::read(expected).unwrap());
    assert!(whole(paged) == map);
}

#[test]
fn every_new_high_of_memory_is_told_once() {
    let dir = tempfile::tempdir().unwrap();
    let map = VoxelMap::new(config()).unwrap();
    let mut paged = PagedMap::create(dir.path().join("a.store"), map, b"", Some(1 << 18)).unwrap();
    let mut told: Vec<OverLimit> = Vec::new();
    let (sensor, mut scans) = drive();
    let mut method = Method::Raycast.build(&FuseConfig::default(), Some(&sensor));
    // Each sees farther than the one before.
    for (number, scan) in scans.iter_mut().take(12).enumerate() {
        let range_m = 0.6 * (number + 1) as f32;
        scan.points.iter_mut().for_each(|p| *p = p.clamp_length_max(range_m));
        paged.integrate(&mut *method, scan).unwrap();
        if let Some(event) = paged.over_limit() {
            assert_eq!(event.limit_bytes, 1 << 18);
            assert!(told.last().is_none_or(|last| event.bytes > last.bytes + last.bytes / 4));
            told.push(event);
        }
        assert_eq!(paged.over_limit(), None);
    }
    assert!(told.len() >= 3, "{told:?}");
    // Nothing that mattered was kept silent.
    let last = told.last().unwrap().bytes;
    assert!(paged.most_bytes() <= last + last / 4, "{told:?} {}", paged.most_bytes());
    // And with enough memory nothing is told.
    let enough = VoxelMap::new(config()).unwrap();
    let mut enough = PagedMap::create(dir.path().join("b.store"), enough, b"", Some(1 << 30)).unwrap();
    enough.integrate(&mut *method, &scans[0]).unwrap();
    assert_eq!(enough.over_limit(), None);
}

#[test]
fn stores_that_are_none_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let open = || PagedMap::open(&path, LITTLE).map(drop).unwrap_err().to_string();
    assert!(open().contains("a.store: No such file"), "{}", open());
    std::fs::write(&path, vec![7; 10_000]).unwrap();
    let told = open();
    assert!(told.contains("a.store: ") && told.lines().count() == 1, "{told}");
    std::fs::write(&path, b"redb and more").unwrap();
    let told = open();
    assert!(
        told.contains("a.store: this store was written by an earlier version"),
        "{told}"
    );
    let create = |name: &str| {
        let map = VoxelMap::new(config()).unwrap();
        let created = PagedMap::create(dir.path().join(name), map, b"", LITTLE);
        created.map(drop).unwrap_err().to_string()
    };
    let told = create("a.store");
    assert!(told.ends_with("a.store: is there already"), "{told}");
    let told = create("no/a.store");
    assert!(told.contains("no/a.store: No such file"), "{told}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn a_store_stays_until_one_in_its_place_holds_its_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let (sensor, scans) = drive();
    let mut paged = new_store(&path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..2], &[2]);
    drop(paged);
    let checkpoint = || PagedMap::open_read_only(&path, LITTLE).unwrap().1;
    // A folder in the place of the file that the new store is written to first: as if the disk failed.
    let temporary = dir.path().join(format!(".a.store.{}.tmp", std::process::id()));
    std::fs::create_dir(&temporary).unwrap();
    let replace = || PagedMap::replace(&path, VoxelMap::new(config()).unwrap(), b"anew", LITTLE);
    replace().map(drop).unwrap_err();
    assert_eq!(checkpoint(), b"2");
    std::fs::remove_dir(&temporary).unwrap();
    drop(replace().unwrap());
    assert_eq!(checkpoint(), b"anew");
    let mut anew = replace().unwrap();
    fused_with_little(&mut anew, Method::Raycast, &sensor, &scans[..1], &[1]);
    drop(anew);
    assert_eq!(checkpoint(), b"1");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}
