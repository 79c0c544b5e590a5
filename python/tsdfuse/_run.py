"""Whole runs: from a log to files, as the command ``tsdfuse`` does them."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Union

from . import _core
from ._progress import Progress, callback
from .errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike

Path = Union[str, "os.PathLike[str]"]
Settings = Union[_core.Config, Mapping[str, Any], Path]
"""A :class:`Config`, a dictionary (``{"raycast.distance": "projective"}``) or the path of a TOML file."""
Which = Union[str, slice, range]
"""Scans by their numbers: ``"0..80:2"``, ``slice(0, 80, 2)`` or ``range(0, 80, 2)``."""
Size = Union[int, str]
"""Bytes, or text as ``"2G"``."""


def selection(scans: Which | None, hold_out: int | None = None) -> dict[str, Any]:
    """Which scans, as the engine has it."""
    first, end, step = 0, None, 1
    if isinstance(scans, str):
        found = re.fullmatch(r"\s*(\d*)\.\.(\d*)(?::(\d+))?\s*", scans)
        if found is None:
            raise ConfigError(f"scans: FROM..TO or FROM..TO:STEP is wanted, as in 0..80:2, not {scans}")
        first, end, step = int(found[1] or 0), int(found[2]) if found[2] else None, int(found[3] or 1)
    elif scans is not None:
        first, end, step = scans.start or 0, scans.stop, scans.step or 1
    if first < 0 or step < 1 or (end is not None and end <= first):
        raise ConfigError(f"scans: {scans} selects nothing; numbers count from the first scan")
    return {"from": first, "to": end, "step": step, "hold_out": hold_out}


def size(memory: Size | None) -> int | None:
    """Bytes of a size as ``2G``."""
    if memory is None or isinstance(memory, int):
        return memory
    found = re.fullmatch(r"([0-9.]+)\s*([KMGT]?)i?B?", memory.strip().upper())
    if found is None:
        raise ConfigError(f"memory: a size is wanted, as in 512M or 8G, not {memory}")
    return int(float(found[1]) * 2 ** {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}[found[2]])


def open_options(
    poses: Path | None,
    sensor: str | Sequence[str] | None,
    extrinsics: ArrayLike | None,
    calibration: Path | None,
) -> dict[str, Any]:
    """How a log is opened, as the engine has it."""
    options: dict[str, Any] = {"poses": poses, "calibration": calibration}
    if sensor is not None:
        options["sensors"] = [sensor] if isinstance(sensor, str) else list(sensor)
    if extrinsics is not None:
        options["extrinsics"] = pose_fields(extrinsics)
    return options


def pose_fields(matrix: ArrayLike, name: str = "extrinsics") -> dict[str, Any]:
    """Rotation (quaternion x, y, z, w) and translation of a rigid matrix."""
    import numpy as np

    m: np.ndarray[Any, Any] = np.asarray(matrix, dtype=float)
    if m.shape not in ((3, 4), (4, 4)) or np.abs(m[:3, :3].T @ m[:3, :3] - np.eye(3)).max() > 1e-3:
        raise ConfigError(f"{name} must be a rigid matrix of the shape (4, 4)")
    # The quaternion is the eigenvector of the largest eigenvalue (Bar-Itzhack 2000).
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = m[:3, :3].tolist()
    k = [
        [xx - yy - zz, yx + xy, zx + xz, zy - yz],
        [yx + xy, yy - xx - zz, zy + yz, xz - zx],
        [zx + xz, zy + yz, zz - xx - yy, yx - xy],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    rotation = np.linalg.eigh(np.array(k))[1][:, -1]
    return {"rotation": rotation.tolist(), "translation": m[:3, 3].tolist()}


def _poses(poses: Path | None) -> tuple[str, Path | None]:
    """Where poses come from, and the file that they are in."""
    if poses is None:
        return "any", None
    if poses in ("log", "track", "refine"):
        return str(poses), None
    if isinstance(poses, str) and poses.startswith("refine:"):
        return "refine", poses[len("refine:") :]
    return "log", poses


def open(  # noqa: A001
    path: Path,
    *,
    poses: Path | None = None,
    sensor: str | Sequence[str] | None = None,
    extrinsics: ArrayLike | None = None,
    calibration: Path | None = None,
) -> _core.Log:
    """Opens a log: a folder, a recording, a capture, or ``udp://:2368``; its format is recognised.

    :param poses: a TUM or KITTI file, or in a recording of messages the topic or frame, instead of the log's poses.
    :param sensor: which sensors of the log, or the model of the only one (``"vlp16"``).
    :param extrinsics: ``body_from_sensor`` (4, 4), metres: the poses are those of a body that carries the sensor.
    :param calibration: the calibration of a sensor whose packets are read.
    """
    return _core.Log(os.fspath(path), open_options(poses, sensor, extrinsics, calibration))


def job(
    log: Path,
    output: Path | None = None,
    *,
    poses: Path | None = None,
    scans: Which | None = None,
    hold_out: int | None = None,
    sensor: str | Sequence[str] | None = None,
    extrinsics: ArrayLike | None = None,
    calibration: Path | None = None,
    skip_bad: bool = False,
    config: Settings | None = None,
    device: str = "cpu",
    memory: Size | None = None,
    store: Path | None = None,
    commit_every: int = 100,
    loops: bool = True,
    load_map: Path | None = None,
    initial_pose: ArrayLike | None = None,
    color: bool = False,
    intensity: bool = False,
    save_map: Path | None = None,
    save_poses: Path | None = None,
    preview: Path | None = None,
    report: Path | None = None,
    mesh_every: int | None = None,
    **options: Any,
) -> dict[str, Any]:
    """A run as plain data, which :func:`run` runs here or anywhere; the arguments are those of :func:`fuse`."""
    origin, file = _poses(poses)
    return {
        "input": {
            "path": os.fspath(log),
            "options": open_options(file, sensor, extrinsics, calibration),
            "selection": selection(scans, hold_out),
            "skip_bad": skip_bad,
        },
        "poses": origin,
        "open_loops": not loops,
        "settings": _core.Config(config, **options).settings(),
        "device": device,
        "memory_bytes": size(memory),
        "store": store,
        "commit_every": commit_every,
        "load_map": load_map,
        "initial_pose": None if initial_pose is None else pose_fields(initial_pose, "initial_pose"),
        "outputs": {
            "mesh": output,
            "mesh_every": mesh_every,
            "color": color,
            "intensity": intensity,
            "map": save_map,
            "poses": save_poses,
            "preview": preview,
            "report": report,
        },
    }


def run(job: Mapping[str, Any], *, progress: Progress = None) -> dict[str, Any]:
    """Runs a job, which :func:`job` makes, and gives its report."""
    return _core.run(job, callback(progress, "fusing"))


def fuse(
    log: Path,
    output: Path | None = None,
    *,
    poses: Path | None = None,
    scans: Which | None = None,
    hold_out: int | None = None,
    sensor: str | Sequence[str] | None = None,
    extrinsics: ArrayLike | None = None,
    calibration: Path | None = None,
    skip_bad: bool = False,
    method: str | None = None,
    voxel_size: float | None = None,
    truncation: float | None = None,
    max_weight: float | None = None,
    min_range: float | None = None,
    max_range: float | None = None,
    min_weight: float | None = None,
    config: Settings | None = None,
    device: str = "cpu",
    memory: Size | None = None,
    store: Path | None = None,
    commit_every: int = 100,
    loops: bool = True,
    load_map: Path | None = None,
    initial_pose: ArrayLike | None = None,
    color: bool = False,
    intensity: bool = False,
    save_map: Path | None = None,
    save_poses: Path | None = None,
    preview: Path | None = None,
    report: Path | None = None,
    mesh_every: int | None = None,
    progress: Progress = None,
) -> dict[str, Any]:
    """Fuses a log and writes files, as ``tsdfuse fuse`` does, and gives the report that the command writes.

    Ctrl-C stops between two scans: what was fused is written, then ``KeyboardInterrupt`` is raised.

    :param log: a folder or a file; its format is recognised.
    :param output: the mesh, ``.ply``, ``.glb``, ``.obj``, or ``NAME/tileset.json`` for 3D Tiles.
    :param poses: a file, a topic or a frame; ``"log"``, ``"track"`` (odometry), ``"refine"``, ``"refine:FILE"``. Without it the
        log's, or odometry where it has none.
    :param scans: ``"0..80:2"``, ``slice(0, 80, 2)`` or ``range(0, 80, 2)``.
    :param hold_out: leaves out the middle one of each so many scans.
    :param sensor: which sensors of the log, or the model of the only one.
    :param extrinsics: ``body_from_sensor`` (4, 4), metres.
    :param skip_bad: leaves out scans that cannot be used; otherwise the first one raises :class:`BadScanError`.
    :param method: ``"patch"``, ``"raycast"``, ... (see ``docs/methods.md``).
    :param voxel_size: metres.
    :param truncation: half the width of the band around the surface, metres.
    :param min_range: nearer returns are dropped, metres.
    :param max_range: farther returns are dropped, metres.
    :param min_weight: voxels of less weight have no surface.
    :param config: all other options.
    :param device: ``"cpu"``, ``"gpu"`` or ``"gpu:NAME"``.
    :param memory: most memory for blocks of the map, bytes or ``"2G"``; the rest is in a file.
    :param store: keeps the map in this file as it grows; :func:`resume` goes on with it.
    :param loops: whether the poses that odometry finds, or that are refined, are corrected where the sensor comes back.
    :param load_map: continues a saved map.
    :param initial_pose: about where in the saved map the first scan was taken (4, 4), if the log has no poses.
    :param color: the mesh gets the colours that the log's cameras saw.
    :param intensity: intensities are averaged; the mesh and the map get them.
    :param save_map, save_poses, preview, report: further files to write.
    :param progress: see :data:`Progress`.
    """
    work = job(
        log, output, poses=poses, scans=scans, hold_out=hold_out, sensor=sensor, extrinsics=extrinsics,
        calibration=calibration, skip_bad=skip_bad, config=config, device=device, memory=memory, store=store,
        commit_every=commit_every, loops=loops, load_map=load_map, initial_pose=initial_pose, color=color,
        intensity=intensity, save_map=save_map, save_poses=save_poses, preview=preview, report=report, mesh_every=mesh_every, method=method, voxel_size=voxel_size, truncation=truncation,
        max_weight=max_weight, min_range=min_range, max_range=max_range, min_weight=min_weight,
    )  # fmt: skip
    return run(work, progress=progress)


def resume(store: Path, output: Path | None = None, *, progress: Progress = None) -> dict[str, Any]:
    """Goes on with a run of :func:`fuse` or ``tsdfuse fuse --store`` that was ended early; gives its report."""
    return _core.resume(os.fspath(store), output, callback(progress, "fusing"))


def session(
    log: _core.Log | None = None,
    *,
    sensor: str | Mapping[str, Any] | None = None,
    track: bool = False,
    refine: bool = False,
    scans: Which | None = None,
    skip_bad: bool = False,
    config: Settings | None = None,
    device: str = "cpu",
    memory: Size | None = None,
    store: Path | None = None,
    commit_every: int = 100,
    load_map: Path | None = None,
    follow_every: int | None = None,
    progress: Progress = None,
    **options: Any,
) -> _core.Session:
    """A run step by step, on any device, with a map of any size: of a log, or of scans that :meth:`Session.fuse` is given.

    As a context manager, it ends the fusing (and commits the store) when the block ends without an exception.

    :param sensor: the model of the sensor whose scans are given, if there is no log.
    :param track: odometry finds the poses. :param refine: the log's poses are refined first.
    :param follow_every: scans from one entry of :meth:`Session.changes` to the next.

    The other arguments are those of :func:`fuse`.
    """
    settings = _core.Config(config, **options)
    setup = {
        "config": settings.resolve(log),
        "track": track,
        "refine": refine,
        "selection": selection(scans),
        "skip_bad": skip_bad,
        "device": device,
        "memory_bytes": size(memory),
        "store": store,
        "commit_every": commit_every,
        "load_map": load_map,
        "follow_every": follow_every,
    }
    return _core.Session(setup, log, sensor, callback(progress, "refining"))


def odometry(
    log: Path | _core.Log,
    *,
    scans: Which | None = None,
    refine: bool = False,
    loops: bool = True,
    save_graph: Path | None = None,
    poses: Path | None = None,
    sensor: str | Sequence[str] | None = None,
    extrinsics: ArrayLike | None = None,
    calibration: Path | None = None,
    config: Settings | None = None,
    progress: Progress = None,
    **options: Any,
) -> _core.Trajectory:
    """Finds the poses of a log's scans: a :class:`Trajectory` with times (N,) in nanoseconds and ``world_from_sensor`` (N, 4, 4).

    The world is the sensor's frame at its first scan. ``times, poses = tsdfuse.odometry(log)`` works, too. The log's inertial
    measurement unit, if there is one, is used.

    :param refine: improves the log's poses instead: each scan is registered to what the others saw.
    :param loops: whether the poses are corrected where the sensor comes back.
    :param save_graph: writes the pose graph of the loops (g2o).
    :param poses: where those to refine come from.
    :param config: options of odometry and of loops, as all others: ``{"loops.gap_m": 20, "odometry.imu": False}``.

    Keywords are those of :class:`Config`: ``min_range``, ``max_range``.
    """
    opened = log if isinstance(log, _core.Log) else open(log, poses=poses, sensor=sensor, extrinsics=extrinsics, calibration=calibration)
    return _core.track(
        opened, scans=selection(scans), refine=refine, loops=loops, save_graph=save_graph, config=config,
        progress=callback(progress, "tracking"), **options,
    )  # fmt: skip


def evaluate(
    log: Path,
    methods: Sequence[str] | str = (),
    *,
    method_set: Sequence[str] = (),
    output: Path | None = None,
    reference: Path | None = None,
    hold_out: int | None = None,
    margin: float | None = None,
    every: int = 1,
    protocol: str | None = None,
    samples: int | None = None,
    runs: int = 1,
    max_error: float = 0.05,
    keep_meshes: bool = False,
    tune: float | None = None,
    poses: Path | None = None,
    scans: Which | None = None,
    sensor: str | Sequence[str] | None = None,
    extrinsics: ArrayLike | None = None,
    calibration: Path | None = None,
    skip_bad: bool = False,
    config: Settings | None = None,
    progress: Progress = None,
    **options: Any,
) -> dict[str, Any]:
    """Compares methods on a log: error, completeness, held-out scans, speed, memory. Each runs in a process of its own.

    ``pandas.json_normalize(report["methods"])`` makes a table of it. What each figure means: ``docs/evaluation.md``.

    :param methods: names; all, if there are none.
    :param method_set: forms, written out: ``"raycast:map.voxel_size_m=0.1"``.
    :param output: a folder for ``report.html``, tables and pictures.
    :param reference: what meshes are compared with; otherwise the true surface of a simulated log, or its points.
    :param runs: runs of each method, whose median speed counts.
    :param tune: searches the best method, voxels and truncation for so many seconds instead.
    """
    origin, file = _poses(poses)
    if origin in ("track", "refine"):
        raise ConfigError(f"poses {origin}: evaluate needs poses that are known; write them with tsdfuse.odometry")
    asked = {
        "input": {
            "path": os.fspath(log),
            "options": open_options(file, sensor, extrinsics, calibration),
            "selection": selection(scans),
            "skip_bad": skip_bad,
        },
        "settings": _core.Config(config, **options).settings(),
        "methods": [methods] if isinstance(methods, str) else list(methods),
        "method_set": list(method_set),
        "hold_out": hold_out,
        "margin_m": margin,
        "reference": reference,
        "every": every,
        "protocol": protocol,
        "samples": samples,
        "runs": runs,
        "max_error_m": max_error,
        "output": output,
        "keep_meshes": keep_meshes,
        "tune": tune,
    }
    return _core.evaluate(asked, command_start(), callback(progress, "evaluating"))


def command_start() -> list[str]:
    """What starts the command ``tsdfuse``: this interpreter."""
    return [sys.executable, "-m", "tsdfuse"]


def simulate(
    scene: str,
    output: Path | None = None,
    *,
    sensor: str = "pandar64",
    scans: int = 80,
    path: str | ArrayLike | None = None,
    noise: float | None = None,
    dropout: float | None = None,
    grazing_loss: bool = True,
    motion: bool = False,
    seed: int = 0,
    offset: Sequence[float] | None = None,
) -> _core.Simulation:
    """Scans of a scene whose surface is known exactly: a sequence of :class:`Scan` with ``.mesh()`` and ``.distance(points)``.

    :param scene: ``"street"``, ``"hall"``, ``"sphere"``, ...
    :param output: also writes a folder that is a log, with the true surface and what beams hit, as ``tsdfuse simulate`` does.
    :param path: how the sensor moves: a name, or ``world_from_sensor`` (N+1, 4, 4).
    :param noise: standard deviation of ranges, metres.
    :param motion: moves the sensor during each sweep.
    """
    simulation = _core.Simulation(
        scene, sensor, scans=scans, path=path, noise=noise, dropout=dropout, grazing_loss=grazing_loss, motion=motion,
        seed=seed, offset=offset,
    )  # fmt: skip
    if output is not None:
        if path is not None and not isinstance(path, str):
            raise ConfigError("a folder is written of a path that has a name")
        given = {"--path": path, "--noise": noise, "--dropout": dropout}
        arguments = ["tsdfuse", "simulate", "--scene", scene, "--sensor", sensor, "--scans", str(scans), "--seed", str(seed)]
        arguments += [word for flag, value in given.items() if value is not None for word in (flag, str(value))]
        arguments += ["--grazing-loss", "on" if grazing_loss else "off", "-o", os.fspath(output)]
        arguments += ["--motion"] if motion else []
        arguments += [] if offset is None else ["--offset=" + ",".join(repr(float(x)) for x in offset)]
        if _core.command(command_start(), arguments) != 0:
            raise OSError(f"{os.fspath(output)}: could not be written")
    return simulation
