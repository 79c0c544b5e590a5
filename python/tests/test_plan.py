"""What planners ask: distances, free space, moving returns, the ground."""

import numpy as np
import pytest

import tsdfuse


def wall(x: float = 3.0, extra: np.ndarray | None = None) -> tsdfuse.Scan:
    """A wall across the x axis, and a floor before it."""
    y, z = np.meshgrid(np.arange(-3, 3, 0.03), np.arange(-1, 2, 0.03))
    points = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
    u, v = np.meshgrid(np.arange(0.5, 3, 0.03), np.arange(-3, 3, 0.03))
    floor = np.stack([u.ravel(), v.ravel(), np.full(u.size, -1.0)], axis=1)
    parts = [points, floor] + ([] if extra is None else [extra])
    return tsdfuse.Scan(np.concatenate(parts), pose=np.eye(4))


def test_distances_follow_a_map() -> None:
    m = tsdfuse.Map(voxel_size=0.05, method="raycast")
    esdf = tsdfuse.Esdf(voxel_size=0.1, radius=1.0)
    m.fuse(wall())
    assert esdf.update(m.changes()) > 0
    distances, gradients, known = esdf.distance([[2.5, 0, 0.5], [-3, 0, 0]])
    assert known.tolist() == [True, False]
    assert abs(distances[0] - 0.5) < 0.05 and np.isnan(distances[1])
    assert gradients[0, 0] < -0.9
    whole = tsdfuse.Esdf(voxel_size=0.1, radius=1.0)
    whole.update(m)
    for a, b in zip(esdf.voxels(), whole.voxels(), strict=True):
        assert np.array_equal(a, b)
    (voxels, distances), (array, lowest) = esdf.voxels(), esdf.dense()
    assert np.array_equal(array[tuple((voxels - lowest).T)], distances)
    assert np.count_nonzero(~np.isnan(array)) == len(distances)
    with pytest.raises(tsdfuse.ConfigError):
        tsdfuse.Esdf(voxel_size=0)


def test_what_is_far_from_a_robot_is_told_in_turns() -> None:
    m = tsdfuse.Map(voxel_size=0.05, method="raycast")
    m.fuse(wall())
    esdf, whole = tsdfuse.Esdf(voxel_size=0.1, radius=1.0), tsdfuse.Esdf(voxel_size=0.1, radius=1.0)
    whole.update(m)
    nearby = tsdfuse.Nearby(radius=5)
    told = []
    for _ in range(20):
        nearby.move_to(np.array([0.0, 500.0, 0.0]))
        changes = m.changes(nearby)
        told.append(len(changes))
        esdf.update(changes, nearby)
    assert max(told[1:10]) > 0 and sum(told[10:]) == 0
    for a, b in zip(esdf.voxels(), whole.voxels(), strict=True):
        assert np.array_equal(a, b)


def test_free_space_is_known() -> None:
    occupancy = tsdfuse.Occupancy(voxel_size=0.2)
    occupancy.fuse(wall())
    assert occupancy.at([[1.5, 0.1, 0.1], [3.05, 0.1, 0.5], [9, 0, 0]]).tolist() == [1, 2, 0]
    voxels, occupied = occupancy.voxels()
    assert len(voxels) == len(occupied) and 0 < occupied.sum() < len(occupied)
    states, lowest = occupancy.dense()
    at = tuple((voxels - lowest).T)
    assert (states[at] == 1 + occupied).all() and np.count_nonzero(states) == len(voxels)
    costs, corner = occupancy.slice(-0.5, 1.0, inflate=0.4)
    assert costs.shape[1] >= 15 and corner[0] <= 0.01
    assert costs.max() == 100 and 0 < np.count_nonzero((costs > 0) & (costs < 100))
    frontiers = occupancy.frontiers(min_voxels=5)
    sizes = [len(of) for _, of in frontiers]
    assert sizes and sizes == sorted(sizes, reverse=True) and sizes[-1] >= 5
    center, of = frontiers[0]
    assert np.allclose(center, (of + 0.5).mean(axis=0) * 0.2)
    with pytest.raises(tsdfuse.ConfigError):
        occupancy.slice(50, 60)


def test_what_comes_into_free_space_moves() -> None:
    moving = tsdfuse.Moving()
    for _ in range(10):
        assert not moving.classify(wall()).any()
    y, z = np.meshgrid(np.arange(-0.4, 0.4, 0.03), np.arange(-0.4, 0.4, 0.03))
    thing = np.stack([np.full(y.size, 1.8), y.ravel(), z.ravel()], axis=1)
    found = moving.classify(wall(extra=thing))
    assert found[-len(thing) :].all() and not found[: -len(thing)].any()


def test_the_ground_is_flat_and_the_wall_is_not() -> None:
    m = tsdfuse.Map(voxel_size=0.05, method="raycast")
    m.fuse(wall())
    layers = tsdfuse.ground(m, (0.5, -2.0), (3.5, 2.0))
    assert set(layers) == {"elevation", "slope", "step", "roughness", "traversability"}
    elevation, traversability = layers["elevation"], layers["traversability"]
    assert elevation.shape == (20, 15)
    assert abs(elevation[10, 5] + 1) < 0.03 and traversability[10, 5] > 0.8
    assert traversability[10, 11] == 0
