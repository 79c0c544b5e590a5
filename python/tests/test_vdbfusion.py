"""The calls of VDBFusion's README, with another import."""

from __future__ import annotations

import numpy as np
import pytest
import tsdfuse
from tsdfuse.compat import vdbfusion


class Dataset:
    """Points in the world (N, 3), and where the sensor was (3,)."""

    def __init__(self, simulation: tsdfuse.Simulation) -> None:
        self.simulation = simulation

    def __len__(self) -> int:
        return len(self.simulation)

    def __getitem__(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        scan = self.simulation[number]
        return scan.points_in_world(), scan.pose[:3, 3]


@pytest.mark.parametrize("space_carving", [False, True])
def test_its_readme(room: tsdfuse.Simulation, space_carving: bool) -> None:
    voxel_size, sdf_trunc = 0.1, 0.3
    vdb_volume = vdbfusion.VDBVolume(voxel_size, sdf_trunc, space_carving)
    dataset = Dataset(room)
    for scan, origin in dataset:
        vdb_volume.integrate(scan, origin)
    vert, tri = vdb_volume.extract_triangle_mesh()
    assert vert.shape[1] == tri.shape[1] == 3 and tri.max() < len(vert)
    assert np.median(np.abs(room.distance(vert))) < 0.03


def test_poses_and_weights(room: tsdfuse.Simulation) -> None:
    by_pose, by_origin = (vdbfusion.VDBVolume(voxel_size=0.1, sdf_trunc=0.3, space_carving=False) for _ in range(2))
    scan = room[0]
    world = scan.points_in_world()
    by_pose.integrate(points=world, extrinsic=scan.pose, weight=1.0)
    by_origin.integrate(world, scan.pose[:3, 3], weighting_function=lambda sdf: 1.0)
    # Float32 in two frames: the same up to rounding.
    a, b = by_pose.map.voxels()["weight"], by_origin.map.voxels()["weight"]
    assert abs(len(a) - len(b)) < 0.002 * len(a) and np.isclose(a.sum(), b.sum(), rtol=1e-3)
    vertices, triangles = by_pose.extract_triangle_mesh(fill_holes=True, min_weight=0.05)
    assert 0 < len(triangles) < len(by_pose.extract_triangle_mesh()[1])
    with pytest.raises(tsdfuse.ConfigError):
        by_pose.integrate(world, scan.pose, lambda sdf: 1.0 - abs(sdf))
    with pytest.raises(tsdfuse.ConfigError):
        by_pose.update_tsdf(0.1, [0, 0, 0])
