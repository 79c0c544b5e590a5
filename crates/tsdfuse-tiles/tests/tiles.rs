//! Tilesets as a viewer sees them: what their files hold, against the surface as one mesh.

#![allow(clippy::unwrap_used)] // test helpers

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::Value;
use tsdfuse::glam::{DVec3, IVec3};
use tsdfuse::index::{BLOCK_VOXELS, BlockIndex, voxel_at};
use tsdfuse::map::{Block, Voxel};
use tsdfuse::mesh::{MeshConfig, Surface, extract, is_on_plane};
use tsdfuse::{MapConfig, Mesh, VoxelMap};
use tsdfuse_eval::Reference;
use tsdfuse_io::glb;
use tsdfuse_store::PagedMap;
use tsdfuse_tiles::{Written, write, write_colored};

/// Only the speck is higher.
const SPECK_M: f64 = 8.0;

/// At UTM's coordinates.
const FAR: IVec3 = IVec3::new(691_000 * 20 / 8, 5_335_000 * 20 / 8, 0);

fn map_of(blocks: impl IntoIterator<Item = BlockIndex>, height_m: impl Fn(DVec3) -> f64) -> VoxelMap {
    let mut map = VoxelMap::new(MapConfig::default()).unwrap();
    for index in blocks {
        let mut block = Block::EMPTY;
        for number in 0..BLOCK_VOXELS {
            let center = map.grid().center(voxel_at(index, number));
            let distance = ((center.z - height_m(center)) / map.config().truncation_m).clamp(-1.0, 1.0);
            block.voxels[number] = Voxel {
                weight_sum: 1000,
                distance_sum: (1000.0 * distance).round() as i32,
            };
        }
        map.insert_block(index, block).unwrap();
    }
    map
}

/// Hills of 25 × 25 m, and a speck above them.
fn hills(origin: IVec3) -> VoxelMap {
    let edge = 64;
    let ground = (0..edge * edge * 4).map(|n| IVec3::new(n % edge, n / edge % edge, n / (edge * edge) - 2));
    let at = map_of([], |_| 0.0).grid().center(origin << 3);
    let blocks = ground.map(|i| BlockIndex(i + origin));
    let mut map = map_of(blocks, |p| {
        let p = p - at;
        0.4 * (p.x * 0.9).sin() * (p.y * 0.7).cos() + 0.05 * (p.x * 7.0).sin() * (p.y * 8.0).sin()
    });
    let speck = BlockIndex(origin + IVec3::new(20, 20, 30));
    let mut block = Block::EMPTY;
    for (number, voxel) in block.voxels.iter_mut().enumerate() {
        let from_middle = (voxel_at(speck, number) - speck.first_voxel()).as_dvec3() - 3.4;
        *voxel = Voxel {
            weight_sum: 1000,
            distance_sum: (1000.0 * (from_middle.length() - 0.8) / 10.0) as i32,
        };
    }
    map.insert_block(speck, block).unwrap();
    map
}

fn tiled(map: &VoxelMap, folder: &Path) -> Written {
    let mut surface = Surface::new(map, &MeshConfig::default());
    write(&folder.join("tileset.json"), &mut surface).unwrap()
}

#[test]
fn vertices_of_all_levels_have_the_colours_of_their_places() {
    let map = hills(IVec3::ZERO);
    let dir = tempfile::tempdir().unwrap();
    let mut surface = Surface::new(&map, &MeshConfig::default());
    let color = |v: &DVec3| if v.x > 12.0 { [255, 255, 255] } else { [0, 0, 0] };
    let colors = |mesh: &Mesh| mesh.vertices.iter().map(color).collect();
    write_colored(&dir.path().join("t/tileset.json"), &mut surface, &colors).unwrap();
    // All tiles have one frame, whose x axis is the world's: the border between both colours is at one place.
    let (mut last_black, mut first_white, mut count) = (f64::MIN, f64::MAX, 0);
    for path in fs::read_dir(dir.path().join("t"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
    {
        if path.extension().is_some_and(|e| e == "glb") {
            let bytes = fs::read(&path).unwrap();
            let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
            let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
            let accessor = json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
                .as_u64()
                .unwrap();
            let view = json["accessors"][accessor as usize]["bufferView"].as_u64().unwrap();
            let offset = json["bufferViews"][view as usize]["byteOffset"].as_u64().unwrap_or(0) as usize;
            let colors = &bytes[20 + length + 8 + offset..];
            for (vertex, color) in glb::parse(&path, &bytes)
                .unwrap()
                .vertices
                .iter()
                .zip(colors.chunks_exact(4))
            {
                match color[..3] {
                    [0, 0, 0] => last_black = last_black.max(vertex.x),
                    [255, 255, 255] => first_white = first_white.min(vertex.x),
                    _ => panic!("{color:?} is neither"),
                }
                count += 1;
            }
        }
    }
    assert!(
        count > 1000 && last_black < first_white,
        "{count} {last_black} {first_white}"
    );
}

fn tileset(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("tileset.json")).unwrap()).unwrap()
}

fn children(tile: &Value) -> &[Value] {
    tile.get("children")
        .map_or(&[], |children| children.as_array().unwrap())
}

fn error_m(tile: &Value) -> f64 {
    tile["geometricError"].as_f64().unwrap()
}

fn leaves(tile: &Value) -> Vec<&Value> {
    match children(tile) {
        [] => vec![tile],
        below => below.iter().flat_map(leaves).collect(),
    }
}

/// Every tile that has others below it.
fn coarse(tile: &Value) -> Vec<&Value> {
    let below = children(tile).iter().flat_map(coarse);
    let own = (!children(tile).is_empty()).then_some(tile);
    own.into_iter().chain(below).collect()
}

/// Least and greatest coordinates of a tile's box.
fn bounds(tile: &Value) -> [DVec3; 2] {
    let numbers: Vec<f64> = tile["boundingVolume"]["box"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n.as_f64().unwrap())
        .collect();
    let (middle, half) = (
        DVec3::from_slice(&numbers),
        DVec3::new(numbers[3], numbers[7], numbers[11]),
    );
    [middle - half, middle + half]
}

/// A tile's mesh in the coordinates of the tileset: as `gltf` reads it, turned so that z is up.
fn mesh(folder: &Path, tile: &Value) -> Mesh {
    let path = folder.join(tile["content"]["uri"].as_str().unwrap());
    let bytes = fs::read(path).unwrap();
    let file = gltf::Gltf::from_slice(&bytes).unwrap();
    // The crate has it in f32.
    let json: Value = serde_json::from_slice(&gltf::Glb::from_slice(&bytes).unwrap().json).unwrap();
    let middle: [f64; 3] = serde_json::from_value(json["nodes"][1]["translation"].clone()).unwrap();
    let outer = file.scenes().next().unwrap().nodes().next().unwrap();
    let inner = outer.children().next().unwrap();
    // glTF's y is up, and a viewer turns x, y, z to x, -z, y; the outer node does the inverse.
    let (_, [x, y, z, w], _) = outer.transform().decomposed();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert_eq!([x, y, z, w], [-half, 0.0, 0.0, half]);
    let primitive = inner.mesh().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|_| file.blob.as_deref());
    let number: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
    Mesh {
        vertices: reader
            .read_positions()
            .unwrap()
            .map(|p| DVec3::from(p.map(f64::from)) + DVec3::from(middle))
            .collect(),
        normals: reader.read_normals().unwrap().map(Into::into).collect(),
        triangles: number.as_chunks().0.to_vec(),
    }
}

/// Triangles by their corners in millimetres, from the least one on; `shift_mm` moves what is rounded to either side.
fn triangles(mesh: &Mesh, shift_mm: f64) -> BTreeMap<[[i64; 3]; 3], usize> {
    let mut all = BTreeMap::new();
    for corners in &mesh.triangles {
        let corner = |v: u32| {
            (mesh.vertices[v as usize] * 1e3 + shift_mm)
                .round()
                .as_i64vec3()
                .to_array()
        };
        let mut corners = corners.map(corner);
        let first = (0..3).min_by_key(|k| corners[*k]).unwrap();
        corners.rotate_left(first);
        *all.entry(corners).or_default() += 1;
    }
    all
}

/// Which share of the triangles of `a` has no like in `b`, however millimetres are rounded.
fn missing(a: &Mesh, b: &Mesh) -> f64 {
    let share = |shift_mm| {
        let (a, b) = (triangles(a, shift_mm), triangles(b, shift_mm));
        let unlike = a.iter().filter(|(corners, n)| b.get(*corners) != Some(*n)).count();
        unlike as f64 / a.len() as f64
    };
    [0.0, 0.25, 0.5].into_iter().map(share).fold(1.0, f64::min)
}

/// The meshes of some tiles.
fn joined(folder: &Path, tiles: &[&Value]) -> Mesh {
    let mut all = Mesh::default();
    for tile in tiles {
        let first = all.vertices.len() as u32;
        let part = mesh(folder, tile);
        all.vertices.extend(part.vertices);
        all.normals.extend(part.normals);
        all.triangles
            .extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    all
}

#[test]
fn the_finest_tiles_are_the_mesh_and_the_others_are_as_near_as_they_say() {
    let dir = tempfile::tempdir().unwrap();
    for (name, offset) in [("near", IVec3::new(-30, -30, 0)), ("far", FAR)] {
        let (folder, map) = (dir.path().join(name), hills(offset));
        let written = tiled(&map, &folder);
        let set = tileset(&folder);
        assert_eq!(set["asset"]["version"], "1.1");
        let root = &set["root"];
        let transform: Vec<f64> = serde_json::from_value(root["transform"].clone()).unwrap();
        let origin = DVec3::from_slice(&transform[12..]);
        assert_eq!(root["refine"], "REPLACE");

        let whole = extract(&map).unwrap();
        let finest = joined(&folder, &leaves(root));
        assert_eq!(
            (written.triangles, finest.triangles.len()),
            (whole.triangles.len(), whole.triangles.len())
        );
        let placed = Mesh {
            vertices: whole.vertices.iter().map(|v| v - origin).collect(),
            ..whole.clone()
        };
        // A few in a hundred are rounded to another millimetre.
        assert!(
            missing(&placed, &finest) < 0.05 && missing(&finest, &placed) < 0.05,
            "{name}: {}",
            missing(&placed, &finest)
        );
        let moved = Mesh {
            vertices: placed.vertices.iter().map(|v| v + 0.0007).collect(),
            ..placed.clone()
        };
        assert!(missing(&moved, &finest) > 0.5, "{name}");
        let surface = Reference::mesh(placed).unwrap();
        assert!(
            surface.are_within(&finest.vertices, 1e-5).iter().all(|near| *near),
            "{name}"
        );
        assert!(
            finest
                .normals
                .iter()
                .all(|n| (n.length() - 1.0).abs() < 1e-3 && n.z > -0.95)
        );

        let coarse = coarse(root);
        assert!(coarse.len() >= 2 && written.levels >= 3, "{name}: {}", coarse.len());
        let mut on_borders = 0;
        for tile in coarse {
            let (own, finest) = (mesh(&folder, tile), joined(&folder, &leaves(tile)));
            let counts = (own.triangles.len(), finest.triangles.len());
            assert!(counts.0 < counts.1, "{name}: {counts:?}");
            let [low, high] = bounds(tile);
            for child in children(tile) {
                let [child_low, child_high] = bounds(child);
                assert!((low - child_low).max(child_high - high).max_element() < 1e-9, "{name}");
                assert!(error_m(child) < error_m(tile), "{name}: {child} {tile}");
            }
            for v in own.vertices.iter().chain(&finest.vertices) {
                assert!(v.cmpge(low).all() && v.cmple(high).all(), "{name}: {v} {low} {high}");
            }
            // Where tiles meet, no vertex is missing.
            let level: u32 = tile["content"]["uri"]
                .as_str()
                .unwrap()
                .split('_')
                .next()
                .unwrap()
                .parse()
                .unwrap();
            let at_border = |v: &&DVec3| is_on_plane(map.grid(), **v + origin, 128 << level);
            let border: Vec<DVec3> = finest.vertices.iter().filter(at_border).copied().collect();
            on_borders += border.len();
            let corners = Reference::cloud(own.vertices.clone()).unwrap();
            assert!(corners.are_within(&border, 1e-5).iter().all(|near| *near), "{name}");
            let far = Reference::mesh(own)
                .unwrap()
                .are_within(&finest.vertices, error_m(tile));
            // The speck may be smaller than the error.
            let lost = far
                .iter()
                .zip(&finest.vertices)
                .filter(|(near, v)| !**near && v.z + origin.z < SPECK_M);
            assert_eq!(lost.count(), 0, "{name}: {}", error_m(tile));
        }
        assert!(on_borders > 100, "{name}: {on_borders}");
        // Of the speck nothing is left at the top, and something is at the bottom.
        let speck = |mesh: &Mesh| mesh.vertices.iter().filter(|v| v.z + origin.z > SPECK_M).count();
        assert!(speck(&finest) > 0 && speck(&mesh(&folder, root)) == 0, "{name}");
    }
}

/// The names of a folder's files, and what is in them.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(Result::unwrap);
    entries
        .map(|e| (e.file_name().into_string().unwrap(), fs::read(e.path()).unwrap()))
        .collect()
}

#[test]
fn neither_threads_nor_memory_make_a_difference() {
    let dir = tempfile::tempdir().unwrap();
    let map = hills(IVec3::new(-30, -30, 0));
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let folder = dir.path().join(threads.to_string());
        pool.install(|| tiled(&map, &folder));
        files(&folder)
    };
    let one = with_threads(1);
    assert!(one.len() > 4 && one == with_threads(3));

    let store = dir.path().join("a.store");
    let mut all = map.clone();
    let mut paged = PagedMap::create(&store, map, b"", None).unwrap();
    paged.commit(b"").unwrap();
    drop(paged);
    let (mut paged, _) = PagedMap::open(&store, Some(1 << 20)).unwrap();
    let folder = dir.path().join("paged");
    write(&folder.join("tileset.json"), &mut paged.surface(&MeshConfig::default())).unwrap();
    assert!(files(&folder) == one);
    assert!(paged.map_in_memory().block_count() < all.block_count());
    // The comparison sees a voxel.
    let mut other = BlockIndex(IVec3::new(0, 0, 5));
    other.0 += all.block_indices()[0].0;
    all.insert_block(
        other,
        map_of([other], |p| p.z.floor() + 0.4).block(other).unwrap().clone(),
    )
    .unwrap();
    tiled(&all, &dir.path().join("other"));
    assert!(files(&dir.path().join("other")) != one);
}

#[test]
fn places_far_apart_make_few_tiles() {
    let dir = tempfile::tempdir().unwrap();
    let far = (1 << 27) - 1;
    let places = [
        [0, 0, 0],
        [far, far, far],
        [-far, 0, far],
        [2_500_000, 2_500_000, 0],
        [-1, -1, -1],
    ];
    let blocks: Vec<BlockIndex> = places.into_iter().map(|at| BlockIndex(IVec3::from(at))).collect();
    let mut map = map_of([], |_| 0.0);
    for block in blocks {
        let middle = map.grid().center(block.first_voxel() + 4).z;
        let part = map_of([block], |_| middle + 0.01);
        map.insert_block(block, part.block(block).unwrap().clone()).unwrap();
    }
    let folder = dir.path().join("far");
    let written = tiled(&map, &folder);
    // Two of the five are one tile.
    assert!(written.tiles <= 8 && written.levels <= 5, "{written:?}");
    let whole = extract(&map).unwrap();
    assert_eq!(written.triangles, whole.triangles.len());
    // The finest are where they should be, in f32 and all.
    let set = tileset(&folder);
    let transform: Vec<f64> = serde_json::from_value(set["root"]["transform"].clone()).unwrap();
    let mut finest = joined(&folder, &leaves(&set["root"])).vertices;
    finest
        .iter_mut()
        .for_each(|v| *v += DVec3::from_slice(&transform[12..]));
    let distances = Reference::cloud(whole.vertices).unwrap().distances(&finest);
    assert!(distances.iter().all(|d| *d < 1e-4));
}

#[test]
fn what_cannot_be_written_is_told_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |map: &VoxelMap, path: &str| {
        let mut surface = Surface::new(map, &MeshConfig::default());
        write(&dir.path().join(path), &mut surface).unwrap_err().to_string()
    };
    let empty = VoxelMap::new(MapConfig::default()).unwrap();
    let told = "the map has no surface: no triangle with a weight of 0 or more";
    assert_eq!(refused(&empty, "a/tileset.json"), told);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    fs::create_dir(dir.path().join("full")).unwrap();
    fs::write(dir.path().join("full/precious"), b"").unwrap();
    let told = refused(&empty, "full/tileset.json");
    assert!(told.ends_with("full: is not empty; name a new folder"), "{told}");
    let told = refused(&empty, "no/such/tileset.json");
    assert!(told.contains("such: there is no folder "), "{told}");
    let told = refused(&empty, "full/precious/tileset.json");
    assert!(told.contains("precious: "), "{told}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    // An empty folder is as good as none.
    fs::create_dir(dir.path().join("empty")).unwrap();
    assert_eq!(
        tiled(&hills(IVec3::ZERO), &dir.path().join("empty")).tiles,
        files(&dir.path().join("empty")).len() - 1
    );
}
