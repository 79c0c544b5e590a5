"""What tasks do, on any node: plain functions of plain data. Each leaves files, and a record that says that it is done."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path as LocalPath
from typing import Any

import tsdfuse
from tsdfuse._core import write_cells

from ._storage import Folder, fetched

Task = dict[str, Any]
Record = dict[str, Any]


class Clock:
    """What stages of a task took: wall time, and time of the processor."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.cpu_seconds: dict[str, float] = {}
        self.last = time.perf_counter(), time.process_time()

    def stage(self, name: str) -> None:
        """Ends a stage."""
        now = time.perf_counter(), time.process_time()
        for stages, end, begin in zip((self.seconds, self.cpu_seconds), now, self.last):
            stages[name] = stages.get(name, 0.0) + end - begin
        self.last = now

    def told(self) -> Record:
        return {"seconds": self.seconds, "cpu_seconds": self.cpu_seconds}


def named(cell: list[int]) -> str:
    """The name of a cell, in file names."""
    return "_".join(map(str, cell))


def opened(job: Task, log: int) -> tsdfuse.Log:
    """A log of a job."""
    return tsdfuse.open(fetched(job["logs"][log]), **job["open"])


def empty(job: Task) -> tsdfuse.Map:
    """A map without scans, as all tasks begin with."""
    return tsdfuse.Map(config=job["settings"], sensor=job["sensor"])


def look(job: Task, task: Task) -> Record:
    """What is in a log."""
    log = opened(job, task["log"])
    if bool((log.poses != log.poses).any()) and not job["skip_bad"]:
        raise tsdfuse.FormatError(f"{job['logs'][task['log']]}: the poses of all scans must be known")
    suggested = log.suggested.resolve()
    told: Record = {"scans": len(log), "notes": log.notes, "suggested": {key: suggested[key] for key in ("method", "map")}}
    # Of the first log: the sensor that its first scan tells, which all tasks must take it for.
    told["sensor"] = log.guess_sensor() if task["log"] == 0 else None
    return told


def fuse_span(job: Task, task: Task) -> Record:
    """Some scans, for methods that only add: the parts of cells that they make. Where memory ends, the map so far is written, and an
    empty one begun: sums can be added later."""
    clock, work = Clock(), Folder(job["work"])
    parts: list[Record] = []
    skipped: list[str] = []
    made, fused = empty(job), 0

    def write() -> None:
        nonlocal made
        clock.stage("fuse")
        with work.working() as folder:
            for part in write_cells(made, folder, job["edge"], skin=True):
                into = f"spans/{task['name']}/{len(parts):04}-{named(part['cell'])}"
                parts.append(put(work, folder, part, into))
        made = empty(job)
        clock.stage("write")

    for _, scan in scans(job, task["log"], task["scans"], skipped):
        try:
            made.fuse(scan)
            fused += 1
        except tsdfuse.BadScanError as error:
            skip(job, skipped, error)
        if made.memory_bytes > job["memory"]:
            write()
    write()
    return {"parts": parts, "fused": fused, "skipped": skipped, **clock.told()}


def put(work: Folder, folder: LocalPath, cell: Record, into: str) -> Record:
    """Shares a cell that was written: its inner blocks, and the outermost, which its neighbours need, too."""
    name = named(cell["cell"])
    return {
        "cell": cell["cell"],
        "blocks": cell["blocks"],
        "map": work.put(folder / f"{name}.tsdf", f"{into}.tsdf", cell["checksum"]),
        "skin": work.put(folder / f"{name}.skin", f"{into}.skin", cell["skin_checksum"]),
    }


def skip(job: Task, skipped: list[str], error: Exception) -> None:
    if not job["skip_bad"]:
        raise error
    skipped.append(str(error))


def scans(job: Task, log: int, numbers: list[int], skipped: list[str]) -> Iterator[tuple[int, tsdfuse.Scan]]:
    """Some scans of a log with their numbers, in order; those that cannot be read are noted."""
    reading = opened(job, log).select(numbers)
    for number in numbers:
        try:
            yield number, next(reading)
        except (tsdfuse.Error, OSError) as error:
            skip(job, skipped, error)


def merge(job: Task, task: Task) -> Record:
    """Parts of one cell, added."""
    clock, work, limited, reading = Clock(), Folder(job["work"]), 0, 0
    made = empty(job)
    for part in (part[kind] for part in task["parts"] for kind in ("map", "skin")):
        with work.reading(part["name"], part["checksum"]) as path:
            limited += made.merge(path)
            reading += part["bytes"]
    clock.stage("merge")
    part = written(job, made, task["into"])
    clock.stage("write")
    return {"part": part, "limited": limited, "read": reading, **clock.told()}


def written(job: Task, made: tsdfuse.Map, into: str) -> Record | None:
    """Writes the map of one cell; ``None`` if all of it was erased again."""
    work = Folder(job["work"])
    with work.working() as folder:
        for cell in write_cells(made, folder, job["edge"], skin=True):
            return put(work, folder, cell, into)
    return None


def survey_span(job: Task, task: Task) -> Record:
    """Which cells each of some scans may change, for methods that erase."""
    clock, asked = Clock(), empty(job)
    cells: dict[str, list[int]] = {}
    skipped: list[str] = []
    good: list[int] = []
    for number, scan in scans(job, task["log"], task["scans"], skipped):
        try:
            reached = asked.reach(scan).cells(job["edge"])
        except tsdfuse.BadScanError as error:
            skip(job, skipped, error)
            continue
        good.append(number)
        for cell in reached:
            cells.setdefault(named(cell), []).append(number)
    clock.stage("survey")
    return {"cells": cells, "good": good, "skipped": skipped, **clock.told()}


def fuse_cell(job: Task, task: Task) -> Record:
    """All scans that reach a cell, in order and with their own numbers; what they change elsewhere is forgotten."""
    clock, made = Clock(), empty(job)
    first = [job["edge"] * x for x in task["cell"]]
    end = [job["edge"] + x for x in first]
    for part in task["scans"]:
        # The number of a scan among all: those before it in this log, without those that were skipped, and those of the logs before.
        at = dict(zip(part["scans"], part["numbers"]))
        for number, scan in scans({**job, "skip_bad": False}, part["log"], part["scans"], []):
            made.fuse(scan, number=at[number])
            made.keep_regions(first, end)
    clock.stage("fuse")
    part = written(job, made, f"cells/{named(task['cell'])}")
    clock.stage("write")
    return {"part": part, "fused": sum(len(part["scans"]) for part in task["scans"]), **clock.told()}


def tile(job: Task, task: Task) -> Record:
    """The surface of a cell as 3D Tiles, beside those of its neighbours."""
    clock, work, output = Clock(), Folder(job["work"]), Folder(job["output"])
    made, reading = empty(job), 0
    for part in [task["whole"], *task["skins"]]:
        with work.reading(part["name"], part["checksum"]) as path:
            made.merge(path)
            reading += part["bytes"]
    name = named(task["cell"])
    with output.working() as folder:
        try:
            found = made.write_cell_tiles(
                task["cell"], job["edge"], folder / name / "tileset.json", min_weight=job["min_weight"]
            )
        except tsdfuse.EmptyResultError:
            return {"root": None, "read": reading, **clock.told()}
        tileset = json.loads((folder / name / "tileset.json").read_text())
        output.put_all(folder / name, name)
    root = tileset["root"]
    told = {"box": root["boundingVolume"]["box"], "transform": root["transform"], "error": tileset["geometricError"]}
    clock.stage("tile")
    return {"root": told, "tiles": found, "read": reading, **clock.told()}
