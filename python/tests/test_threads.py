"""The interpreter's lock is free while the engine works, and Ctrl-C is heard."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
import tsdfuse

OPTIONS = {"voxel_size": 0.1, "truncation": 0.3, "method": "raycast"}


def test_python_goes_on_while_the_engine_works(room: tsdfuse.Simulation) -> None:
    scan = room[0].cleaned_by()
    ticks, done = 0, threading.Event()

    def work() -> None:
        made = tsdfuse.Map(voxel_size=0.01, truncation=0.3, method="raycast")
        made.fuse(scan)  # one call that takes long
        done.set()

    worker = threading.Thread(target=work)
    worker.start()
    while not done.is_set():
        ticks += 1
        time.sleep(0.001)
    worker.join()
    assert ticks > 10


def test_two_threads_fuse_at_once(log: Path, tmp_path: Path) -> None:
    # Each run waits in its callback for the other one: both are under way, or this never ends.
    meet = threading.Barrier(2, timeout=60)
    failed: list[BaseException] = []

    def work(number: int) -> None:
        def progress(done: int, total: int | None, what: str) -> None:
            if done in (2, 6) and total == 12 and (number, done) not in met:
                met.add((number, done))
                meet.wait()

        try:
            tsdfuse.fuse(log, save_map=tmp_path / f"{number}.tsdf", progress=progress, **OPTIONS)
        except BaseException as error:  # noqa: BLE001
            failed.append(error)

    met: set[tuple[int, int]] = set()
    threads = [threading.Thread(target=work, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed and len(met) == 4
    assert (tmp_path / "0.tsdf").read_bytes() == (tmp_path / "1.tsdf").read_bytes()


def test_threads_share_a_map(room: tsdfuse.Simulation, fused: tsdfuse.Map) -> None:
    shared = tsdfuse.Map(**OPTIONS)
    scans = list(room)

    def work(part: list[tsdfuse.Scan]) -> None:
        for scan in part:
            shared.fuse(scan)
            shared.distance([[0.0, 0.0, 0.0]])

    threads = [threading.Thread(target=work, args=(scans[i::3],)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert shared == fused  # sums do not depend on the order


@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
def test_ctrl_c_stops_between_scans(log: Path, tmp_path: Path) -> None:
    def interrupt(done: int, total: int | None, what: str) -> None:
        if done == 3:
            os.kill(os.getpid(), signal.SIGINT)

    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        tsdfuse.fuse(log, save_map=tmp_path / "a.tsdf", progress=interrupt, voxel_size=0.03, truncation=0.12)
    assert time.monotonic() - begun < 60
    # What was fused before is there.
    assert 3 <= tsdfuse.Map.load(tmp_path / "a.tsdf").integrations < 12
