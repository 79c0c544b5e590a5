"""VDBFusion's ``VDBVolume`` on this engine: change the import, keep the rest.

    from tsdfuse.compat.vdbfusion import VDBVolume

What differs: voxels are fused by ``raycast`` in its projective form, which is VDBFusion's own update up to rounding; maps are saved as
``.tsdf`` files, not as ``.vdb``; weights are those of ``raycast`` unless a weighting function is given to :meth:`VDBVolume.integrate`,
of which only constants are possible.
"""

from __future__ import annotations

import os
from typing import Any, Callable, Union, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import Map, Mesh, Scan
from ..errors import ConfigError


class VDBVolume:
    """A truncated signed distance field with VDBFusion's methods.

    :param voxel_size: metres.
    :param sdf_trunc: half the width of the band around the surface, metres.
    :param space_carving: VDBFusion updates free space, too; here that is the method ``patch``, which erases what rays pass through.
    """

    def __init__(self, voxel_size: float, sdf_trunc: float, space_carving: bool = False) -> None:
        self.voxel_size = voxel_size
        self.sdf_trunc = sdf_trunc
        self.space_carving = space_carving
        config = {"method": "patch"} if space_carving else {"method": "raycast", "raycast.distance": "projective"}
        # VDBFusion leaves ranges to its callers.
        self.map = Map(voxel_size, sdf_trunc, config=config, min_range=0.0, max_range=1e6)
        self._origin = np.zeros(3)

    def __repr__(self) -> str:
        return f"VDBVolume(voxel_size={self.voxel_size}, sdf_trunc={self.sdf_trunc}, space_carving={self.space_carving})"

    @overload
    def integrate(self, points: ArrayLike, extrinsic: ArrayLike, weight: float = ...) -> None: ...
    @overload
    def integrate(
        self, points: ArrayLike, extrinsic: ArrayLike, weighting_function: Callable[[float], float]
    ) -> None: ...
    @overload
    def integrate(self, grid: Any, weight: float = ...) -> None: ...

    def integrate(self, *args: Any, **kwargs: Any) -> None:
        """Fuses points.

        :param points: (N, 3) in the **world**, metres, as VDBFusion has them.
        :param extrinsic: the pose of the sensor (4, 4), or its position (3,).
        """
        names = ("points", "extrinsic", "weight")
        given = dict(zip(names, args), **kwargs)
        if "grid" in given or "extrinsic" not in given:
            raise ConfigError("integrate: a grid of OpenVDB cannot be integrated; give points and the sensor's pose")
        weight: Any = given.get("weighting_function", given.get("weight", 1.0))
        if callable(weight):
            weight = _constant(cast("Callable[[float], float]", weight), self.sdf_trunc)
        if weight != 1.0:
            raise ConfigError(f"integrate: all weights are those of the method; {weight} is not possible")
        world = np.asarray(given["points"], dtype=np.float64)
        pose = np.asarray(given["extrinsic"], dtype=np.float64)
        if pose.shape in ((3,), (3, 1)):
            pose = _at(pose.reshape(3))
        # Relative to the sensor, numbers are small enough for float32.
        in_sensor = (world - pose[:3, 3]) @ pose[:3, :3]
        self.map.fuse(Scan(in_sensor.astype(np.float32), pose))

    def update_tsdf(self, sdf: float, ijk: ArrayLike, weighting_function: Callable[[float], float] | None = None) -> None:
        """Not possible: voxels are sums of observations."""
        raise ConfigError("update_tsdf: single voxels cannot be set")

    def extract_triangle_mesh(
        self, fill_holes: bool = True, min_weight: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Vertices (V, 3), metres, and triangles (T, 3).

        :param fill_holes: has no effect: surface is extracted where all eight voxels around were observed.
        :param min_weight: voxels of less weight have no surface.
        """
        mesh = self.mesh(min_weight=min_weight)
        return mesh.vertices, mesh.triangles

    def mesh(self, *, min_weight: float = 0.0) -> Mesh:
        """The same with normals, as a :class:`tsdfuse.Mesh`."""
        return self.map.mesh(min_weight=min_weight)

    def extract_vdb_grids(self, out_file: Union[str, os.PathLike[str]]) -> None:
        """Saves the map, as a ``.tsdf`` file whatever its name: OpenVDB's files are not written."""
        self.map.save(out_file)

    def prune(self, min_weight: float) -> Map:
        """The map; surface of less weight is left out by :meth:`extract_triangle_mesh`."""
        return self.map

    @property
    def pyopenvdb_support_enabled(self) -> bool:
        """``False``: there are no grids of OpenVDB here."""
        return False


def _at(position: NDArray[np.float64]) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


def _constant(weighting: Callable[[float], float], truncation: float) -> float:
    """The value of a function that has only one."""
    values = {float(weighting(sdf)) for sdf in np.linspace(-truncation, truncation, 9)}
    if len(values) != 1:
        raise ConfigError("integrate: weighting functions are not possible; choose a method instead")
    return values.pop()
