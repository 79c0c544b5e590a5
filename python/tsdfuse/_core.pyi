import os
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Callable, Literal, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Path = Union[str, os.PathLike[str]]
_Progress = Callable[[int, Union[int, None], str], Any]
_Settings = Union["Config", Mapping[str, Any], _Path]
_Sensor = Union[str, Mapping[str, Any]]
_Image = Literal["shaded", "normal", "depth", "weight"]

class Config:
    """What is set of all options; the rest is what a log suggests, or the default.

    ``Config(method="raycast", voxel_size=0.1)``, ``Config({"raycast.distance": "projective"})`` or ``Config("run.toml")``; options by name go
    before those of the first argument. ``docs/methods.md`` lists all keys. Raises :class:`ConfigError` for what cannot be.
    """

    def __new__(
        cls,
        config: _Settings | None = None,
        /,
        *,
        method: str | None = None,
        voxel_size: float | None = None,
        truncation: float | None = None,
        max_weight: float | None = None,
        min_range: float | None = None,
        max_range: float | None = None,
        min_weight: float | None = None,
    ) -> Config: ...
    def settings(self) -> dict[str, Any]:
        """What is set: a dictionary of sections."""
    def resolve(self, log: Log | None = None) -> dict[str, Any]:
        """All options: what is set, else what the log suggests, else the defaults."""
    def __getitem__(self, key: str) -> Any:
        """A section, or one option: ``config["map.voxel_size_m"]``."""
    def __eq__(self, other: object) -> bool: ...

class Scan:
    """One sweep of a sensor, or a depth image.

    :param points: (N, 3), metres, in the sensor's frame (x forward, y left, z up), each at the moment it was measured.
    :param pose: ``world_from_sensor`` (4, 4) at time 0 of ``times``.
    :param rings: (N,) the laser of each return, 0 = lowest.
    :param times: (N,) seconds after the pose at which each return was measured.
    :param intensities: (N,) in the sensor's own unit.
    :param motion: seconds (K,) and poses (K, 4, 4) during the sweep: with ``times`` it undoes the sensor's motion.
    :param camera: intrinsics of a depth image, each of whose points lies on the ray of its pixel: see :meth:`of_depth`.
    :param time_ns: nanoseconds of the pose.
    :param name: for messages.
    """

    def __new__(
        cls,
        points: ArrayLike,
        pose: ArrayLike | None = None,
        *,
        rings: ArrayLike | None = None,
        times: ArrayLike | None = None,
        intensities: ArrayLike | None = None,
        motion: tuple[ArrayLike, ArrayLike] | None = None,
        camera: Mapping[str, float] | None = None,
        time_ns: int | None = None,
        name: str | None = None,
    ) -> Scan: ...
    @staticmethod
    def of_depth(
        depth: ArrayLike,
        *,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        pose: ArrayLike | None = None,
        time_ns: int | None = None,
        name: str | None = None,
    ) -> Scan:
        """A scan of a depth image (H, W): metres along the optical axis, 0 or NaN where nothing was measured.

        :param fx, fy, cx, cy: intrinsics as of OpenCV, pixels; pixel (0, 0) has its centre at 0, 0.
        :param pose: ``world_from_sensor`` (4, 4); the sensor's frame is x forward (the optical axis), y left, z up.
        """
    @property
    def name(self) -> str: ...
    @property
    def time_ns(self) -> int | None: ...
    @property
    def points(self) -> NDArray[np.float32]:
        """(N, 3), metres, sensor frame: a copy."""
    @property
    def rings(self) -> NDArray[np.uint16] | None: ...
    @property
    def times(self) -> NDArray[np.float32] | None: ...
    @property
    def intensities(self) -> NDArray[np.float32] | None: ...
    @property
    def pose(self) -> NDArray[np.float64] | None:
        """``world_from_sensor`` (4, 4)."""
    @property
    def motion(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Seconds (K,) and poses (K, 4, 4) during the sweep."""
    @property
    def camera(self) -> dict[str, Any] | None: ...
    @property
    def sensor(self) -> str | None:
        """The name of the sensor, if the scan is one of a log."""
    @property
    def dropped(self) -> dict[str, int]:
        """Returns that were left out so far, by reason."""
    def points_in_world(self) -> NDArray[np.float64]:
        """(N, 3), metres, each placed from where the sensor was when it measured it."""
    def with_pose(self, pose: ArrayLike, motion: tuple[ArrayLike, ArrayLike] | None = None) -> Scan:
        """The same scan from elsewhere: ``world_from_sensor`` (4, 4), and where the sensor moved, if it did."""
    def undistorted(self) -> Scan:
        """The scan as it would have been measured all at once, at the time of its pose."""
    def cleaned_by(self, min_range: float | None = None, max_range: float | None = None) -> Scan:
        """The scan without returns that measure nothing, or out of range (metres; the log's limits, or the defaults)."""
    def __len__(self) -> int: ...

class Log:
    """An opened log: a sequence of scans, read when they are asked for. :func:`open` opens it.

    Iterating reads ahead on other threads, and drops invalid returns by the ranges that suit the log; ``log[i]`` gives the scan as it was
    measured.
    """

    def __new__(cls, path: _Path, options: Mapping[str, Any] | None = None) -> Log: ...
    @property
    def path(self) -> str: ...
    @property
    def format(self) -> str: ...
    @property
    def sensors(self) -> list[dict[str, Any]]:
        """Name, model, camera, nearest range (m) and ``body_from_sensor`` (4, 4) of each sensor."""
    @property
    def names(self) -> list[str]: ...
    @property
    def times_ns(self) -> NDArray[np.int64] | None:
        """(N,) nanoseconds of each scan; ``None`` if one has no time."""
    @property
    def poses(self) -> NDArray[np.float64]:
        """(N, 4, 4) ``world_from_sensor`` of each scan; NaN where it is not known."""
    @property
    def trajectory(self) -> Trajectory | None:
        """``world_from_body`` over time, where the log has such poses."""
    @property
    def notes(self) -> list[str]:
        """What is missing or odd, one sentence each."""
    @property
    def suggested(self) -> Config:
        """What fusing this log wants where nothing is set."""
    @property
    def recorded(self) -> dict[str, Any] | None:
        """The topics of a recording, and what was concluded from it."""
    @property
    def images(self) -> list[dict[str, Any]]:
        """The images of all cameras: name, time, intrinsics, distortion, ``world_from_camera`` (4, 4, optical frame)."""
    def read_image(self, index: int) -> bytes:
        """The encoded bytes (JPEG, PNG) of an image."""
    def imu(self) -> dict[str, NDArray[Any]]:
        """``times_ns`` (N,), ``angular_velocity`` (N, 3) in rad/s, ``acceleration`` (N, 3) in m/s², body frame."""
    def gnss(self) -> list[dict[str, Any]]:
        """Time, latitude, longitude (degrees, WGS 84), height (m, or None), standard deviations (m, or None) and antenna (m, body frame) of each fix."""
    def guess_sensor(self) -> dict[str, Any] | None:
        """The model of the first sensor: the log's, or guessed from its first scan."""
    def select(self, selection: Mapping[str, Any] | Sequence[int] | None = None) -> Scans:
        """Iterates over some scans: ``{"from": 10, "to": 80, "step": 2}``, or their numbers."""
    def __len__(self) -> int: ...
    def __getitem__(self, index: int) -> Scan: ...
    def __iter__(self) -> Scans: ...

class Scans(Iterator[Scan]):
    """Scans in order, read ahead."""

    def __iter__(self) -> Scans: ...
    def __next__(self) -> Scan: ...

class Fused:
    """What became of a scan."""

    @property
    def returns(self) -> int:
        """Returns that reached the map."""
    @property
    def skipped(self) -> dict[str, int]:
        """Measurements that the method had no use for, by reason."""
    @property
    def dropped(self) -> dict[str, int]:
        """Returns that are no measurements, by reason."""
    @property
    def blocks(self) -> NDArray[np.int32]:
        """(K, 3) the blocks that changed; block b begins at 8 · b · voxel_size metres."""

class Mesh:
    """A triangle mesh: ``vertices`` (V, 3) float64 in the world, metres, ``normals`` (V, 3) float32, ``triangles`` (T, 3) int32."""

    def __new__(cls, vertices: ArrayLike, triangles: ArrayLike, normals: ArrayLike | None = None) -> Mesh: ...
    @staticmethod
    def read(path: _Path) -> Mesh:
        """Reads ``.ply``, ``.obj`` or ``.glb``."""
    def write(self, path: _Path) -> None:
        """Writes ``.ply``, ``.obj`` or ``.glb``, complete or not at all."""
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals, towards free space; none if the mesh has none."""
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    def bounds(self) -> list[list[float]] | None:
        """The lowest and the highest corner; ``None`` for an empty mesh."""
    def topology(self) -> dict[str, Any]:
        """Whether the mesh is manifold and closed."""
    def to_open3d(self) -> Any:
        """An ``open3d.geometry.TriangleMesh``."""
    def to_trimesh(self) -> Any:
        """A ``trimesh.Trimesh``, its vertices as they are."""

class Changes:
    """The pieces of a surface that changed, one per block; iterating gives ``(block, mesh)``. A piece without vertices is gone."""

    @property
    def blocks(self) -> NDArray[np.int32]:
        """(K, 3) the block of each piece."""
    @property
    def vertices(self) -> NDArray[np.float64]:
        """(V, 3) of all pieces, one after the other."""
    @property
    def normals(self) -> NDArray[np.float32]: ...
    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) of all pieces, counting from each piece's first vertex."""
    @property
    def vertex_offsets(self) -> NDArray[np.int64]:
        """(K + 1,) where the vertices of each piece begin."""
    @property
    def triangle_offsets(self) -> NDArray[np.int64]:
        """(K + 1,) where the triangles of each piece begin."""
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[tuple[tuple[int, int, int], Mesh]]: ...

class Nearby:
    """The space around a robot: what changes there is wanted at once, what changes elsewhere at every tenth turn.

    :param radius: how far it reaches, metres.
    """

    def __new__(cls, radius: float = 30.0) -> Nearby: ...
    def move_to(self, place: ArrayLike) -> None:
        """The next turn, with the robot at a place (3,), world, metres."""

class Esdf:
    """Euclidean distances to the nearest surface, up to a radius. They follow a map that changes; they are not signed.

    :param voxel_size: edge of a voxel, metres.
    :param radius: the largest distance that is known, metres; at most 45 voxels.
    """

    def __new__(cls, voxel_size: float = 0.2, radius: float = 2.0) -> Esdf: ...
    def update(self, surface: Changes | Map, nearby: Nearby | None = None) -> int:
        """Takes in what changed of a surface, or the whole surface of a map. Returns how many chunks of 32³ voxels were computed anew.

        :param surface: what changed, or a map.
        :param nearby: if given, only distances near a robot follow what changed at once, the rest in turns. A call without it computes all
            that wait.
        """
    def distance(self, points: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Distances (N,), metres, their gradients (N, 3), and where they are known; elsewhere they are NaN."""
    def voxels(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """All voxels within the radius of surface (N, 3), and the distances of their centres, metres. Voxel v has its centre at
        (v + ½) · voxel_size."""
    def dense(self) -> tuple[NDArray[np.float32], tuple[int, int, int]]:
        """All distances as an array (x, y, z), metres, NaN beyond the radius; and the voxel at its lowest corner."""

class Occupancy:
    """What rays have passed through and where they ended: free, occupied, unknown.

    :param voxel_size: edge of a voxel, metres.
    :param max_range: rays are followed up to this range, metres.
    """

    def __new__(cls, voxel_size: float = 0.2, max_range: float = 60.0) -> Occupancy: ...
    def fuse(self, scan: Scan) -> None:
        """Takes in the rays of a scan, which has a pose."""
    def at(self, points: ArrayLike) -> NDArray[np.uint8]:
        """What is known at points (N, 3), world: 0 nothing, 1 free, 2 occupied."""
    def voxels(self) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """All voxels that are known (N, 3), and whether they are occupied."""
    def dense(self) -> tuple[NDArray[np.uint8], tuple[int, int, int]]:
        """All that is known as an array (x, y, z): 0 nothing, 1 free, 2 occupied; and the voxel at its lowest corner."""
    def slice(self, low: float = ..., high: float = ..., inflate: float = 0.0) -> tuple[NDArray[np.int8], tuple[float, float]]:
        """What is known between two heights (world z, metres), from above: costs (rows, columns) from the lowest y on, 100 where any voxel
        is occupied, falling to 0 over ``inflate`` metres, -1 where nothing is known; and the lower left corner, metres."""
    def frontiers(
        self, low: float = ..., high: float = ..., min_voxels: int = 20
    ) -> list[tuple[tuple[float, float, float], NDArray[np.int32]]]:
        """Where free space meets unknown space between two heights: the middle (world, metres) and the voxels (N, 3) of each frontier
        with at least so many voxels, the largest first."""

class Moving:
    """Tells scan by scan which returns move: those in space that was known to be free.

    :param voxel_size: edge of a voxel, metres.
    :param max_range: returns beyond this range are not looked at, metres.
    """

    def __new__(cls, voxel_size: float = 0.25, max_range: float = 80.0) -> Moving: ...
    def classify(self, scan: Scan) -> NDArray[np.bool_]:
        """Whether each return of the next scan moves. It has a pose."""

def ground(
    map: Map,
    low: tuple[float, float],
    high: tuple[float, float],
    cell: float = 0.2,
    *,
    radius: float = 0.5,
    clearance: float = 2.0,
    max_slope: float = 25.0,
    max_step: float = 0.2,
    max_roughness: float = 0.1,
) -> dict[str, NDArray[np.float32]]:
    """Which ground can be driven on within a rectangle (world x, y, metres): ``elevation``, ``slope`` (radians), ``step``, ``roughness``
    (metres) and ``traversability`` (0 to 1), each (rows, columns) from the highest y on; NaN where nothing is known."""

class Map:
    """A truncated signed distance field in memory: fuse scans into it, ask it, mesh it, change it, save it.

    :param voxel_size: edge of a voxel, metres; 0.05 by default.
    :param truncation: half the width of the band around the surface, metres; 0.2 by default.
    :param method: how scans are fused, ``"patch"`` by default, ``"depth"`` for depth images.
    :param min_range, max_range: returns out of this range are dropped, metres; by default as the scan's log suggests.
    :param sensor: the model of sensors whose scans do not tell it: a name, or a dictionary as :func:`sensor` gives it.
    :param config: all other options.

    Threads may ask a map at the same time. All work is done without the interpreter's lock.
    """

    def __new__(
        cls,
        voxel_size: float | None = None,
        truncation: float | None = None,
        *,
        config: _Settings | None = None,
        sensor: _Sensor | None = None,
        method: str | None = None,
        max_weight: float | None = None,
        min_range: float | None = None,
        max_range: float | None = None,
        min_weight: float | None = None,
    ) -> Map: ...
    @staticmethod
    def load(
        path: _Path,
        *,
        config: _Settings | None = None,
        sensor: _Sensor | None = None,
        method: str | None = None,
        min_range: float | None = None,
        max_range: float | None = None,
        min_weight: float | None = None,
    ) -> Map:
        """Loads a saved map (``.tsdf``) or all of a store, to be asked or continued."""
    def fuse(
        self,
        scan: Scan | ArrayLike,
        pose: ArrayLike | None = None,
        *,
        rings: ArrayLike | None = None,
        times: ArrayLike | None = None,
        intensities: ArrayLike | None = None,
        motion: tuple[ArrayLike, ArrayLike] | None = None,
        time_ns: int | None = None,
        name: str | None = None,
        number: int | None = None,
    ) -> Fused:
        """Fuses a scan: a :class:`Scan`, or points (N, 3) with a pose (4, 4) and the columns of a :class:`Scan`.

        :param number: how many scans were fused before it, where this map does not hold them all.

        Raises :class:`BadScanError` for a scan that cannot be used; the map is as it was before.
        """
    def finish(self) -> None:
        """Lets methods that collect scans (``roldao``) fuse them."""
    def mesh(self, *, min_weight: float | None = None, device: str = "cpu") -> Mesh:
        """The surface, by marching cubes."""
    def write_mesh(self, path: _Path, *, min_weight: float | None = None) -> dict[str, Any]:
        """Writes the surface: ``.ply``, ``.glb``, ``.obj``, or ``NAME/tileset.json`` for 3D Tiles."""
    def changes(self, nearby: Nearby | None = None) -> Changes:
        """The pieces of the surface that changed since this was asked last; all of it the first time.

        :param nearby: if given, only what changed near a robot is told at once, the rest in turns, by regions of 64³ voxels. A call
            without it tells all that is left.
        """
    def forget_changes(self) -> None:
        """Frees what is kept for :meth:`changes`."""
    def distance(self, points: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Signed distance (N,) to the nearest surface, metres, its gradient (N, 3), and whether the map knows (N,) at points (N, 3)."""
    def weight(self, points: ArrayLike) -> NDArray[np.float32]:
        """The accumulated weight (N,) at points (N, 3); 0 where nothing is known."""
    def raycast(
        self, origins: ArrayLike, directions: ArrayLike, *, max_range: float = 10_000.0, min_weight: float = 0.0
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """What rays meet first: range (N,), metres, NaN if nothing; unit normal (N, 3); whether there is anything (N,).

        :param origins: (N, 3), or (1, 3) for all. :param directions: (N, 3) of any length but 0.

        The surface is found anew at each call, which takes as long as one or two pictures: cast many rays at once.
        """
    def render(
        self,
        pose: ArrayLike | None = None,
        *,
        width: int = 1280,
        height: int = 720,
        fov_deg: float = 60.0,
        camera: Mapping[str, float] | None = None,
        sensor: _Sensor | None = None,
        min_weight: float = 0.0,
        max_range: float = 10_000.0,
        device: str = "cpu",
    ) -> View:
        """What a camera or a LiDAR sees from a pose (``world_from_camera``, x forward, y left, z up); an overview without one."""
    def turntable(
        self, count: int = 1, *, width: int = 1280, height: int = 720, fov_deg: float = 60.0
    ) -> NDArray[np.float64]:
        """Poses (count, 4, 4) around the map, for :meth:`render`."""
    def box(self, low: ArrayLike, high: ArrayLike) -> dict[str, Any]:
        """The voxels whose centres lie in a box (metres; ``low`` included, ``high`` not).

        ``distance`` and ``weight`` have the shape (z, y, x), NaN and 0 where nothing is known; ``origin`` is the centre of the first voxel.
        """
    def voxels(self) -> dict[str, NDArray[Any]]:
        """All observed voxels: ``index`` (N, 3), ``center`` (N, 3), ``distance`` (N,), ``weight`` (N,)."""
    def merge(self, *others: Map | _Path) -> int:
        """Adds maps, or saved maps, with the same voxels; how many voxels reached ``max_weight``."""
    def cropped(self, low: ArrayLike, high: ArrayLike) -> Map:
        """The voxels whose centres lie in a box, metres; corners may be infinite."""
    def resampled(self, voxel_size: float) -> Map:
        """The same map with voxels of another size, metres."""
    def transformed(self, new_from_old: ArrayLike) -> tuple[Map, bool]:
        """The map in another frame (4, 4), and whether all voxels are unchanged: moved by whole voxels and quarter turns."""
    def copy(self) -> Map: ...
    def save(self, path: _Path) -> None:
        """Saves the map (``.tsdf``), with the poses of its scans; equal maps give equal bytes."""
    def export(self, path: _Path) -> None:
        """Writes the voxels as arrays (``.npz``, ``.zarr``), or the surface as points with normals (``.ply``)."""
    def reach(self, scan: Scan) -> Reach:
        """The part of the map that fusing a scan may change."""
    def keep_regions(self, first: Sequence[int], end: Sequence[int]) -> None:
        """Forgets all outside of these regions, cubes of 64 voxels: ``first`` included, ``end`` not."""
    def write_cell_tiles(
        self, cell: Sequence[int], edge: int, path: _Path, *, min_weight: float | None = None
    ) -> dict[str, Any]:
        """Writes the surface of a cell as 3D Tiles; the map also holds the blocks around it."""
    @property
    def config(self) -> Config: ...
    @property
    def voxel_size(self) -> float: ...
    @property
    def truncation(self) -> float: ...
    @property
    def blocks(self) -> int:
        """Blocks of 8³ voxels."""
    @property
    def observed_voxels(self) -> int: ...
    @property
    def memory_bytes(self) -> int: ...
    @property
    def integrations(self) -> int:
        """How many scans were fused."""
    @integrations.setter
    def integrations(self, integrations: int) -> None: ...
    @property
    def bounds(self) -> NDArray[np.float64] | None:
        """The lowest and the highest corner (2, 3) of all that was observed, metres."""
    @property
    def poses(self) -> Trajectory:
        """The poses of the scans that were fused."""
    def __eq__(self, other: object) -> bool:
        """The same voxels, bit for bit."""
    def __copy__(self) -> Map: ...
    def __deepcopy__(self, memo: Any) -> Map: ...

class Reach:
    """The part of a map that fusing a scan may change."""

    def cells(self, edge: int) -> list[list[int]]:
        """The cells, of ``edge`` regions along each side, that it touches."""
    @property
    def farthest(self) -> float:
        """The range of the farthest return, metres."""

class View:
    """What a camera sees of a map: arrays (H, W), NaN where nothing is; shown as a picture in notebooks."""

    @property
    def depth(self) -> NDArray[np.float32]:
        """Metres along the optical axis; for a LiDAR ranges."""
    @property
    def range(self) -> NDArray[np.float32]:
        """Metres along the ray."""
    @property
    def weight(self) -> NDArray[np.float32]: ...
    @property
    def normals(self) -> NDArray[np.float32]:
        """(H, W, 3) unit vectors, world axes."""
    @property
    def pose(self) -> NDArray[np.float64]:
        """``world_from_camera`` (4, 4)."""
    def image(self, kind: _Image = "shaded") -> NDArray[Any]:
        """A picture: uint8 (H, W) or (H, W, 3); ``depth`` is uint16, millimetres."""
    def write(self, path: _Path, kind: _Image = "shaded") -> None:
        """Writes a ``.png``."""

class Session:
    """A run step by step; :func:`session` begins one."""

    def __new__(
        cls,
        setup: Mapping[str, Any],
        log: Log | None = None,
        sensor: _Sensor | None = None,
        progress: _Progress | None = None,
    ) -> Session: ...
    def step(self) -> bool:
        """Reads and fuses the next scan of the log; whether there may be more."""
    def run(self, progress: _Progress | None = None) -> None:
        """Fuses the rest of the log, and ends the fusing."""
    def fuse(self, scan: Scan) -> None:
        """Fuses a scan that does not come from the log."""
    def finish(self) -> None:
        """Ends the fusing: all scans are in the map, and the store is committed."""
    def commit(self) -> None:
        """Makes all that was fused survive a crash, if there is a store."""
    def close(self) -> None:
        """Lets go of the map and of the store, which others can open then."""
    def changes(self) -> list[Changes]:
        """What changed of the surface since this was asked last, if ``follow_every`` is set."""
    def mesh(self) -> Mesh: ...
    def write_mesh(self, path: _Path) -> dict[str, Any]: ...
    def save(self, path: _Path) -> None: ...
    def map(self) -> Map:
        """A copy of the map, where all of it is in memory."""
    @property
    def done(self) -> int: ...
    @property
    def device(self) -> str | None: ...
    @property
    def poses(self) -> Trajectory: ...
    def report(self) -> dict[str, Any]: ...
    def __enter__(self) -> Session: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

class Store:
    """A map of which only ``memory`` bytes of blocks are in memory: opened for reading. Several processes can do so."""

    def __new__(cls, path: _Path, *, memory: int = ...) -> Store: ...
    def write_mesh(self, path: _Path, *, min_weight: float | None = None) -> dict[str, Any]:
        """Writes the surface: ``.ply`` or ``NAME/tileset.json``."""
    def save(self, path: _Path) -> None:
        """Saves the whole map (``.tsdf``)."""
    def map(self) -> Map:
        """The whole map, in memory."""
    @property
    def path(self) -> str: ...
    @property
    def poses(self) -> Trajectory: ...
    @property
    def blocks(self) -> int: ...
    @property
    def integrations(self) -> int: ...

class Trajectory:
    """Poses in order: ``poses`` (N, 4, 4), ``times_ns`` (N,) nanoseconds or ``None``. ``times, poses = trajectory`` works, too."""

    def __new__(cls, poses: ArrayLike, times_ns: ArrayLike | None = None) -> Trajectory: ...
    @staticmethod
    def read(path: _Path) -> Trajectory:
        """Reads a TUM or KITTI file."""
    def write(self, path: _Path) -> None:
        """Writes TUM where all poses have times that ascend, else KITTI."""
    @property
    def times_ns(self) -> NDArray[np.int64] | None: ...
    @property
    def poses(self) -> NDArray[np.float64]: ...
    @property
    def quality(self) -> dict[str, Any] | None:
        """How well odometry placed each scan, if it did."""
    @property
    def length(self) -> float:
        """The distance travelled, metres."""
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Any]: ...

class Odometry:
    """Tracks scan by scan: each comes out placed, the first one after the second went in."""

    def __new__(cls, *, config: _Settings | None = None, **options: Any) -> Odometry: ...
    def push_imu(self, times_ns: ArrayLike, angular_velocity: ArrayLike, acceleration: ArrayLike) -> None:
        """Takes samples of an inertial measurement unit, in the sensor's frame and in order of time: nanoseconds (N,), rad/s (N, 3) and
        m/s² (N, 3). They come before the scan during which they were measured."""
    def push(self, scan: Scan) -> list[tuple[Scan, dict[str, Any]]]:
        """Takes a scan; those that are placed by now come back, with how well."""
    def finish(self) -> list[tuple[Scan, dict[str, Any]]]:
        """The scans that still wait."""

class Simulation(Sequence[Scan]):
    """A sensor that moves through a scene that is known exactly: a sequence of scans."""

    def __new__(cls, scene: str, sensor: _Sensor | None = None, **options: Any) -> Simulation: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int) -> Scan: ...  # type: ignore[override]
    def mesh(self) -> Mesh:
        """The true surface."""
    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """The exact signed distance (N,) at points (N, 3), metres."""
    @property
    def poses(self) -> NDArray[np.float64]:
        """``world_from_sensor`` (N, 4, 4) of each scan."""

def compare(
    mesh: Mesh,
    reference: Mesh | _Path | ArrayLike,
    *,
    observed: _Path | None = None,
    every: int = 1,
    sensor: str | None = None,
    protocol: str = "surface",
    thresholds: Sequence[float] | None = None,
    crop: Sequence[Sequence[float]] | None = None,
    samples: int | None = None,
    progress: _Progress | None = None,
) -> dict[str, Any]:
    """How far a mesh is from a reference: a file, a log, a mesh, or points (N, 3), metres. ``docs/evaluation.md`` explains the figures."""

def compare_trajectories(trajectory: Trajectory, reference: Trajectory, *, align: bool = True) -> dict[str, Any]:
    """Absolute errors after rigid alignment, and drift."""

def evaluate(asked: Mapping[str, Any], start: Sequence[str], progress: _Progress | None = None) -> dict[str, Any]: ...
def run(job: Mapping[str, Any], progress: _Progress | None = None) -> dict[str, Any]: ...
def resume(store: _Path, output: _Path | None = None, progress: _Progress | None = None) -> dict[str, Any]: ...
def track(
    log: Log,
    *,
    scans: Mapping[str, Any] | None = None,
    refine: bool = False,
    loops: bool = True,
    save_graph: _Path | None = None,
    config: _Settings | None = None,
    progress: _Progress | None = None,
    **options: Any,
) -> Trajectory: ...
def write_cells(map: Map, folder: _Path, edge: int, *, skin: bool = False) -> list[dict[str, Any]]:
    """Writes a map cell by cell: ``FOLDER/X_Y_Z.tsdf``; with ``skin`` the outermost blocks of each are in ``FOLDER/X_Y_Z.skin`` instead."""

def checksum(path: _Path) -> str:
    """The CRC-32 of a file, hexadecimal."""

def sensor(name: str) -> dict[str, Any]:
    """The model of a sensor: beams (degrees), columns, ranges (m)."""

def sensors() -> list[str]:
    """The names of all sensors that are known."""

def set_threads(count: int) -> None:
    """Sets how many threads work, before the first work; it changes no result."""

def threads() -> int: ...
def version() -> str: ...
def command(start: Sequence[str], arguments: Sequence[str]) -> int: ...
