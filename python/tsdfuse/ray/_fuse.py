"""A city on a cluster: what is done in which order."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path as LocalPath
from typing import Any, Union

from .. import Config, __version__
from .._progress import Progress, callback
from .._run import Path, Settings, Size, Which, open_options, selection, size
from ..errors import ConfigError, EmptyResultError
from . import _tasks
from ._schedule import Scheduler
from ._storage import Folder
from ._tasks import Record, Task, named
from ._tiles import tileset

#: Methods whose updates are sums, whatever the map holds.
ADDITIVE = ("raycast", "normals", "surfel", "cylindrical", "kuehner")
#: Methods that look at what the map holds, one block at a time.
BY_CELL = ("patch", "depth", "caminal")
#: Parts of a cell that one task adds.
FAN_IN = 8


def is_additive(config: Mapping[str, Any]) -> bool:
    """Whether the maps of two parts of a log can be added."""
    method = config["method"]
    if method == "patch":
        return not config["patch"]["carve"]
    if method == "roldao":
        if config["roldao"]["form"] == "batch":
            raise ConfigError("roldao.form = batch keeps the points of all scans in one memory; roldao.form=streaming does not")
        return True
    return method in ADDITIVE


def fuse(
    logs: Union[Path, Sequence[Path]],
    output: Path,
    *,
    work: Path | None = None,
    span: int = 200,
    memory_per_task: Size = "2G",
    cpus_per_task: float = 1,
    cell: int | None = None,
    retries: int = 3,
    poses: Path | None = None,
    scans: Which | None = None,
    sensor: str | Sequence[str] | None = None,
    extrinsics: Any = None,
    calibration: Path | None = None,
    skip_bad: bool = False,
    config: Settings | None = None,
    report: Path | None = None,
    progress: Progress = None,
    **options: Any,
) -> dict[str, Any]:
    """Fuses logs on the nodes of a Ray cluster (on this machine, if ``ray.init`` was not called), and gives a report.

    A call that was ended early goes on where it was: tasks that are done are not done again.

    :param logs: one or many, in one world; their scans count in this order. Paths that all nodes see, or URLs of fsspec.
    :param output: ``NAME/tileset.json``: 3D Tiles, one tileset over those of all cells.
    :param work: the folder for maps and records, shared by all nodes or a URL; ``NAME.work`` beside the output otherwise. Its ``cells.json``
        names the saved maps of all cells: for each, one of its inner blocks and one of its outermost (``skin``).
    :param span: scans of one task.
    :param memory_per_task: most memory for the map of one task; Ray starts no more tasks on a node than it has memory for.
    :param cpus_per_task: threads of one task.
    :param cell: regions (64 voxels) along the edge of a cell, a power of two; otherwise 16, or 64 for methods that erase.
    :param retries: how often a task is tried again whose worker or node was lost.

    The other arguments are those of :func:`tsdfuse.fuse`; poses must be known.
    """
    import ray

    begun = time.perf_counter()
    target = os.fspath(output)
    if not target.endswith(".json") or "/" not in target:
        raise ConfigError(f"{target}: the result is 3D Tiles in a folder of their own, NAME/tileset.json")
    folder, name = target.rsplit("/", 1)
    given = [logs] if isinstance(logs, (str, os.PathLike)) else list(logs)
    if poses in ("track", "refine") or str(poses).startswith("refine:"):
        raise ConfigError("a cluster fuses logs whose poses are known: write them first with tsdfuse.odometry")
    job: Task = {
        "version": __version__,
        "logs": [_absolute(os.fspath(log)) for log in given],
        "open": _plain_open(poses, sensor, extrinsics, calibration),
        "scans": selection(scans),
        "skip_bad": skip_bad,
        "asked": Config(config, **options).settings(),
        "span": span,
        "memory": size(memory_per_task),
        "work": _absolute(os.fspath(work) if work is not None else f"{folder}.work"),
        "output": _absolute(folder),
        "edge": cell,
        "sensor": None,
        "settings": {},
        "min_weight": None,
    }
    if not job["logs"] or span < 1:
        raise ConfigError("at least one log, and one scan in a span, are wanted")
    if not ray.is_initialized():
        ray.init(log_to_driver=False)
    told = callback(progress, "on the cluster")
    done = _Run(job, Scheduler(job, cpus_per_task, retries, told)).run(name)
    done["wall_seconds"] = time.perf_counter() - begun
    if report is not None:
        LocalPath(report).write_text(json.dumps(done, indent=1) + "\n")
    return done


def _absolute(path: str) -> str:
    return path if "://" in path else str(LocalPath(path).absolute())


def _plain_open(poses: Path | None, sensor: Any, extrinsics: Any, calibration: Path | None) -> dict[str, Any]:
    open_options(poses, sensor, extrinsics, calibration)  # is wrong here, not on the nodes
    found: dict[str, Any] = {"sensor": sensor, "extrinsics": extrinsics}
    for key, file in (("poses", poses), ("calibration", calibration)):
        # Of a recording, poses may be the name of a topic.
        found[key] = None if file is None or file == "log" else _absolute(os.fspath(file)) if os.path.exists(file) else file
    return found


class _Run:
    """One call of :func:`fuse`."""

    def __init__(self, job: Task, scheduler: Scheduler) -> None:
        self.job = job
        self.scheduler = scheduler
        self.work = Folder(job["work"])
        self.skipped: list[str] = []
        self.limited = 0
        self.fused = 0
        self.moved = {"parts": 0, "merged": 0, "cells": 0, "skins": 0, "tiles": 0}

    def run(self, name: str) -> dict[str, Any]:
        self.check()
        spans = self.plan()
        if self.additive:
            cells = self.by_span(spans)
        else:
            cells = self.by_cell(spans)
        self.work.write("cells.json", [cells[name] for name in sorted(cells)])
        tiles = self.tile(cells)
        if not tiles:
            raise EmptyResultError("the map has no surface")
        Folder(self.job["output"]).write(name, tileset(tiles))
        return {
            "version": __version__,
            "job": self.job,
            "additive": self.additive,
            "spans": len(spans),
            "scans": self.fused,
            "skipped_scans": self.skipped,
            "cells": len(cells),
            "tilesets": len(tiles),
            "blocks": sum(part["blocks"] for part in cells.values()),
            # Beyond max_weight voxels are means: not the bits of one machine.
            "limited_voxels": self.limited,
            "bytes": self.moved,
            "phases": self.scheduler.phases,
        }

    def check(self) -> None:
        """A folder belongs to one job."""
        asked = {key: value for key, value in self.job.items() if key not in ("memory", "settings", "sensor", "edge", "min_weight")}
        asked["cell"] = self.job["edge"]
        asked = json.loads(json.dumps(asked, default=_listed))
        before = self.work.read("job.json")
        if before is None:
            self.work.write("job.json", asked)
        elif before != asked:
            differ = ", ".join(key for key in asked if before.get(key) != asked[key])
            raise ConfigError(f"{self.job['work']}: belongs to a job that differs in {differ}; name another folder with work=")

    def plan(self) -> list[Task]:
        """What all tasks are told, and the spans."""
        looked = self.scheduler.run("look", _tasks.look, ({"name": f"{i:05}", "log": i} for i in range(len(self.job["logs"]))))
        records = [looked[name] for name in sorted(looked)]
        config = Config(records[0]["suggested"]).settings()
        asked = Config(self.job["asked"])
        # Over what the first log suggests of method and voxels; each log suggests its own ranges.
        flat = {**_flat(config), **_flat(asked.settings())}
        # A task knows not all returns of a scan, which tell how well it agrees with the map.
        merged = Config({**flat, "patch.agreement": False, "moving.leave_out": False})
        resolved = merged.resolve()
        self.additive = is_additive(resolved)
        if not self.additive and resolved["method"] not in BY_CELL:
            raise ConfigError(f"the method {resolved['method']} cannot be divided among machines")
        self.job["settings"] = merged.settings()
        self.job["sensor"] = records[0]["sensor"]
        self.job["min_weight"] = resolved["mesh"]["min_weight"]
        self.job["edge"] = self.job["edge"] or (16 if self.additive else 64)
        spans: list[Task] = []
        which = self.job["scans"]
        for log, record in enumerate(records):
            end = record["scans"] if which["to"] is None else min(which["to"], record["scans"])
            numbers = list(range(which["from"], end, which["step"]))
            for first in range(0, len(numbers), self.job["span"]):
                part = numbers[first : first + self.job["span"]]
                spans.append({"name": f"{log:05}-{part[0]:07}", "log": log, "scans": part})
        if not spans:
            raise EmptyResultError("there are no scans")
        return spans

    def by_span(self, spans: list[Task]) -> dict[str, Record]:
        """Spans are fused, and their parts of each cell added by a tree of tasks. A cell that one span alone has seen is whole."""
        records = self.scheduler.run("fuse", _tasks.fuse_span, spans)
        parts: dict[str, list[Record]] = {}
        for span in spans:
            record = records[span["name"]]
            self.skipped += record["skipped"]
            self.fused += record["fused"]
            for part in record["parts"]:
                self.moved["parts"] += part["map"]["bytes"] + part["skin"]["bytes"]
                parts.setdefault(named(part["cell"]), []).append(part)
        if not self.fused:
            raise EmptyResultError("none of the scans could be fused")
        done: dict[str, Record] = {}
        level = 0
        while True:
            done.update({name: found[0] for name, found in parts.items() if len(found) == 1})
            parts = {name: found for name, found in parts.items() if len(found) > 1}
            if not parts:
                return done
            tasks: list[Task] = [
                {"name": f"{name}-{first:06}", "parts": found[first : first + FAN_IN], "into": f"merged/{level}-{first:06}-{name}"}
                for name, found in sorted(parts.items())
                for first in range(0, len(found), FAN_IN)
            ]
            merged = self.scheduler.run(f"merge-{level}", _tasks.merge, tasks)
            parts = {}
            for task in tasks:
                record = merged[task["name"]]
                self.limited += record["limited"]
                self.moved["merged"] += record["read"]
                parts.setdefault(named(record["part"]["cell"]), []).append(record["part"])
            level += 1

    def by_cell(self, spans: list[Task]) -> dict[str, Record]:
        """Each cell is fused from all scans that reach it, in order."""
        records = self.scheduler.run("survey", _tasks.survey_span, spans)
        reached: dict[str, dict[int, tuple[list[int], list[int]]]] = {}
        for span in spans:
            record = records[span["name"]]
            self.skipped += record["skipped"]
            numbers = {scan: self.fused + i for i, scan in enumerate(record["good"])}
            self.fused += len(numbers)
            for name, found in record["cells"].items():
                scans, at = reached.setdefault(name, {}).setdefault(span["log"], ([], []))
                scans += found
                at += [numbers[scan] for scan in found]
        if not reached:
            raise EmptyResultError("none of the scans could be fused")
        tasks: list[Task] = [
            {
                "name": name,
                "cell": [int(x) for x in name.split("_")],
                "scans": [{"log": log, "scans": scans, "numbers": at} for log, (scans, at) in sorted(found.items())],
            }
            for name, found in sorted(reached.items())
        ]
        fused = self.scheduler.run("fuse", _tasks.fuse_cell, tasks)
        return {task["name"]: fused[task["name"]]["part"] for task in tasks if fused[task["name"]]["part"]}

    def tile(self, cells: dict[str, Record]) -> dict[str, tuple[list[int], dict[str, Any]]]:
        """Each cell's surface, with what its neighbours have at their borders."""
        tasks: list[Task] = []
        for name, part in sorted(cells.items()):
            cell, near = part["cell"], (-1, 0, 1)
            self.moved["cells"] += part["map"]["bytes"]
            around = [named([cell[0] + x, cell[1] + y, cell[2] + z]) for x in near for y in near for z in near]
            skins = [cells[other]["skin"] for other in around if other in cells]
            self.moved["skins"] += sum(skin["bytes"] for skin in skins)
            tasks.append({"name": name, "cell": cell, "whole": part["map"], "skins": skins})
        records = self.scheduler.run("tile", _tasks.tile, tasks)
        self.moved["tiles"] += sum(record["tiles"]["bytes"] for record in records.values() if record["root"])
        roots: dict[str, tuple[list[int], dict[str, Any]]] = {}
        for task in tasks:
            if root := records[task["name"]]["root"]:
                roots[task["name"]] = (task["cell"], root)
        return roots


def _flat(settings: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Sections as dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        flat.update(_flat(value, f"{before}{key}.") if isinstance(value, Mapping) else {before + key: value})
    return flat


def _listed(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
