"""Running tasks: on Ray, as many at a time as there is room for, and none that is done already."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, Callable

from .. import _core
from .._progress import Callback
from ._storage import Folder
from ._tasks import Record, Task

Work = Callable[[Task, Task], Record]


class Scheduler:
    """Runs phases of tasks. Each task has a ``name`` in its phase, which is also the name of its record."""

    def __init__(self, job: Task, cpus: float, retries: int, progress: Callback | None) -> None:
        self.job = job
        self.cpus = cpus
        self.retries = retries
        self.progress = progress
        self.work = Folder(job["work"])
        self.phases: list[dict[str, Any]] = []

    def run(self, phase: str, work: Work, tasks: Iterable[Task]) -> dict[str, Record]:
        """All records of a phase, by the names of its tasks."""
        import ray

        begun = time.perf_counter()
        todo = list(tasks)
        folder = f"records/{phase}"
        there = self.work.names(folder)
        records: dict[str, Record] = {}
        for task in todo:
            if f"{task['name']}.json" in there:
                records[task["name"]] = self.work.read(f"{folder}/{task['name']}.json")
        before = len(records)
        job, cpus = ray.put(self.job), self.cpus
        remote = ray.remote(_run)
        under_way: dict[Any, Task] = {}

        def settle(number: int) -> None:
            done, _ = ray.wait(list(under_way), num_returns=number)
            for reference in done:
                task = under_way.pop(reference)
                records[task["name"]] = ray.get(reference)
                if self.progress is not None:
                    self.progress(len(records), len(todo), f"{phase} {task['name']}")

        for task in todo:
            if task["name"] in records:
                continue
            # Records are small, and no more of them are under way than the cluster can work on twice over.
            resources: Any = ray.cluster_resources()  # type: ignore[no-untyped-call]
            room = max(4, int(2 * resources.get("CPU", 1) / cpus))
            while len(under_way) >= room:
                settle(1)
            options = {
                "name": f"{phase} {task['name']}",
                "num_cpus": cpus,
                "memory": self.job["memory"],
                "max_retries": self.retries,
                "retry_exceptions": [ConnectionError, TimeoutError],
            }
            name = f"{folder}/{task['name']}.json"
            under_way[remote.options(**options).remote(job, task, work, name, cpus)] = task
        while under_way:
            settle(1)
        self.phases.append(
            {
                "phase": phase,
                "tasks": len(todo),
                "done_before": before,
                "wall_seconds": time.perf_counter() - begun,
                "seconds": _summed(records, "seconds"),
                "cpu_seconds": _summed(records, "cpu_seconds"),
            }
        )
        return records


def _summed(records: dict[str, Record], key: str) -> dict[str, float]:
    """What all tasks of a phase took, by stages."""
    total: dict[str, float] = {}
    for record in records.values():
        for stage, seconds in record.get(key, {}).items():
            total[stage] = total.get(stage, 0.0) + seconds
    return total


def _run(job: Task, task: Task, work: Work, name: str, cpus: float) -> Record:
    """One task, on any node. Its record is written last: what has one is done."""
    try:
        _core.set_threads(max(1, round(cpus)))
    except ValueError:
        pass  # this process has worked before
    record = work(job, task)
    Folder(job["work"]).write(name, record)
    return record
