"""Fusing into a map, and asking it."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import numpy as np
import pytest
import tsdfuse

OPTIONS = {"voxel_size": 0.1, "truncation": 0.3}


def test_the_example_of_the_readme(sample: Path, tmp_path: Path) -> None:
    m = tsdfuse.Map(voxel_size=0.2, truncation=0.6)
    log = tsdfuse.open(sample)
    for scan in log:
        m.fuse(scan)
    mesh = m.mesh()
    assert mesh.vertices.shape[1:] == (3,) and mesh.vertices.dtype == np.float64
    assert mesh.triangles.shape[1:] == (3,) and mesh.triangles.dtype == np.int32
    assert mesh.normals.shape == mesh.vertices.shape
    mesh.write(tmp_path / "street.ply")
    # The same map and the same mesh as the command's, bit for bit.
    tsdfuse.fuse(
        sample, tmp_path / "command.ply", save_map=tmp_path / "command.tsdf", voxel_size=0.2, truncation=0.6
    )
    assert tsdfuse.Map.load(tmp_path / "command.tsdf") == m
    assert (tmp_path / "command.ply").read_bytes() == (tmp_path / "street.ply").read_bytes()


@pytest.mark.parametrize("method", ["patch", "raycast", "normals", "surfel", "cylindrical"])
def test_arrays_and_scans_give_the_same_map(room: tsdfuse.Simulation, method: str) -> None:
    by_scan = tsdfuse.Map(method=method, **OPTIONS)
    by_array = tsdfuse.Map(method=method, sensor="vlp16", max_range=room[0].cleaned_by().points.max() + 200, **OPTIONS)
    for scan in list(room)[:3]:
        by_scan.fuse(scan)
        done = by_array.fuse(scan.points, scan.pose, rings=scan.rings, times=scan.times, intensities=scan.intensities)
        assert done.returns > 1000 and done.blocks.shape[1] == 3
    assert by_scan == by_array and by_scan.blocks > 100


def test_distances_are_those_of_the_scene(fused: tsdfuse.Map, room: tsdfuse.Simulation) -> None:
    rng = np.random.default_rng(1)
    vertices = fused.mesh().vertices
    points = vertices[rng.integers(len(vertices), size=2000)] + rng.uniform(-0.05, 0.05, (2000, 3))
    distance, gradient, seen = fused.distance(points)
    assert distance.shape == (2000,) and gradient.shape == (2000, 3) and seen.dtype == bool
    assert seen.mean() > 0.5 and np.isnan(distance[~seen]).all()
    exact = room.distance(points[seen])
    assert np.median(np.abs(distance[seen] - exact)) < 0.03
    assert (fused.weight(points)[seen] > 0).all()
    # Points far away are not known.
    assert not fused.distance([[1e4, 0, 0]])[2].any()


def test_rays_and_views_meet_the_surface(fused: tsdfuse.Map, room: tsdfuse.Simulation) -> None:
    scan = room[5]
    world = scan.points_in_world()[::50]
    origin = scan.pose[:3, 3]
    ranges, normals, met = fused.raycast(origin[None], world - origin)
    assert met.mean() > 0.5
    true = np.linalg.norm(world - origin, axis=1)
    assert np.median(np.abs(ranges - true)[met]) < 0.05
    assert np.allclose(np.linalg.norm(normals[met], axis=1), 1, atol=1e-3)
    view = fused.render(width=160, height=90)
    assert view.depth.shape == (90, 160) and view.normals.shape == (90, 160, 3)
    assert view.image().dtype == np.uint8 and view.image("normal").shape == (90, 160, 3)
    assert np.isfinite(view.depth).mean() > 0.1
    seen = fused.render(scan.pose, sensor="vlp16")
    assert seen.depth.shape[0] == 16
    assert fused.turntable(4).shape == (4, 4, 4)


def test_boxes_and_voxels_agree(fused: tsdfuse.Map) -> None:
    low, high = fused.bounds
    box = fused.box(low, high)
    voxels = fused.voxels()
    assert (box["weight"] > 0).sum() == len(voxels["distance"]) == fused.observed_voxels
    z, y, x = (voxels["index"][0] - box["first"])[::-1]
    assert box["distance"][z, y, x] == voxels["distance"][0]
    center = np.array(box["origin"]) + 0.1 * np.array([x, y, z])
    assert np.allclose(center, voxels["center"][0])


def test_what_changed_makes_the_whole_surface(room: tsdfuse.Simulation) -> None:
    made = tsdfuse.Map(method="raycast", **OPTIONS)
    shown: dict[tuple[int, int, int], tsdfuse.Mesh] = {}
    for scan in room:
        made.fuse(scan)
        for block, piece in made.changes():
            shown[block] = piece
    triangles = sum(len(piece.triangles) for piece in shown.values())
    assert triangles == len(made.mesh().triangles) > 1000
    assert len(made.changes()) == 0
    corner = max(shown.values(), key=lambda piece: len(piece.triangles))
    assert corner.triangles.max() < len(corner.vertices)


def test_maps_are_merged_cropped_moved(room: tsdfuse.Simulation, fused: tsdfuse.Map, tmp_path: Path) -> None:
    halves = [tsdfuse.Map(method="raycast", **OPTIONS) for _ in range(2)]
    for number, scan in enumerate(room):
        halves[number % 2].fuse(scan)
    halves[1].save(tmp_path / "half.tsdf")
    other = halves[0].copy()
    assert halves[0].merge(halves[1]) == 0
    assert other.merge(tmp_path / "half.tsdf") == 0
    assert halves[0] == fused == other and halves[0].integrations == 12
    low, high = fused.bounds
    middle = (low + high) / 2
    parts = [fused.cropped(low, [middle[0], *high[1:]]), fused.cropped([middle[0], *low[1:]], high)]
    assert sum(part.observed_voxels for part in parts) == fused.observed_voxels
    quarter = np.array([[0, -1, 0, 8], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)
    moved, exact = fused.transformed(quarter)
    assert exact and moved.observed_voxels == fused.observed_voxels
    assert np.allclose(moved.poses.poses[0], quarter @ fused.poses.poses[0])
    assert fused.resampled(0.2).voxel_size == 0.2
    with pytest.raises(tsdfuse.ConfigError, match="differ in voxel_size_m"):
        fused.merge(fused.resampled(0.2))


def test_maps_survive_files_pickles_and_copies(fused: tsdfuse.Map, room: tsdfuse.Simulation, tmp_path: Path) -> None:
    fused.save(tmp_path / "a.tsdf")
    loaded = tsdfuse.Map.load(tmp_path / "a.tsdf", method="raycast")
    again = pickle.loads(pickle.dumps(fused))
    for other in (loaded, again, copy.copy(fused), copy.deepcopy(fused)):
        assert other == fused and other.integrations == 12
        assert np.array_equal(other.poses.poses, fused.poses.poses)
        # It can be continued like the first one.
        other.fuse(room[0])
    assert loaded == again != fused
    assert again.config == fused.config
    fused.export(tmp_path / "a.npz")
    assert len(np.load(tmp_path / "a.npz")["weights"]) == fused.observed_voxels


def test_patch_continues_as_if_there_was_no_break(room: tsdfuse.Simulation) -> None:
    whole, part = (tsdfuse.Map(method="patch", **OPTIONS) for _ in range(2))
    for number, scan in enumerate(room):
        whole.fuse(scan)
        part.fuse(scan)
        if number == 5:
            part = pickle.loads(pickle.dumps(part))
    assert whole == part


def test_depth_images_are_fused() -> None:
    rows, columns = np.mgrid[0:60, 0:80]
    depth = np.full((60, 80), 2.0, dtype=np.float32)
    depth[:10] = 0  # not measured
    scan = tsdfuse.Scan.of_depth(depth, fx=70, fy=70, cx=39.5, cy=29.5, pose=np.eye(4))
    assert len(scan) == 50 * 80 and scan.camera["width"] == 80
    made = tsdfuse.Map(0.05, 0.2)
    made.fuse(scan)
    mesh = made.mesh()
    assert len(mesh.triangles) > 500 and np.allclose(mesh.vertices[:, 0], 2.0, atol=0.01)


def test_numbers_of_other_types_and_orders_are_taken() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([np.full(500, 4.0), rng.uniform(-1, 1, (500, 2))])
    maps = []
    for given in (points, points.astype(np.float32), np.asfortranarray(points), points.tolist(), np.repeat(points, 2, 0)[::2]):
        made = tsdfuse.Map(method="raycast", **OPTIONS)
        made.fuse(given, np.eye(4))
        maps.append(made)
    assert all(made == maps[0] for made in maps)
    assert tsdfuse.Map(0.1, 0.3).distance(np.zeros((0, 3)))[0].shape == (0,)


def test_representations_tell_something(fused: tsdfuse.Map, room: tsdfuse.Simulation, sample: Path) -> None:
    told = [fused, room, room[0], fused.mesh(), fused.poses, fused.changes(), fused.render(width=64, height=36)]
    told += [tsdfuse.open(sample), tsdfuse.Config(method="raycast", voxel_size=0.1)]
    for thing in told:
        assert any(c.isdigit() for c in repr(thing)) and "object at" not in repr(thing), repr(thing)
    assert repr(tsdfuse.Config(method="raycast", voxel_size=0.1)) == "Config(map.voxel_size_m=0.1, method=raycast)"
