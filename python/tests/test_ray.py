"""Fusing on a cluster: the bits of one machine, whatever happens to workers and nodes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tsdfuse

ray = pytest.importorskip("ray")
import tsdfuse.ray  # noqa: E402

OPTIONS: dict[str, Any] = {"voxel_size": 0.1, "truncation": 0.3}
SMALL: dict[str, Any] = {"span": 5, "cell": 4, "memory_per_task": "200M", **OPTIONS}


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


@pytest.fixture(scope="module")
def whole(log: Path, tmp_path_factory: pytest.TempPathFactory) -> tsdfuse.Map:
    """The map that one machine makes."""
    path = tmp_path_factory.mktemp("whole") / "a.tsdf"
    tsdfuse.fuse(log, save_map=path, method="raycast", **OPTIONS)
    return tsdfuse.Map.load(path)


def united(work: Path, **options: Any) -> tsdfuse.Map:
    """All cells as one map."""
    made = tsdfuse.Map(**OPTIONS, **options)
    cells = json.loads((work / "cells.json").read_text())
    made.merge(*(work / cell[kind]["name"] for cell in cells for kind in ("map", "skin")))
    return made


def leaves(tile: dict[str, Any], folder: Path) -> Iterator[np.ndarray]:
    """The vertices of the finest tiles of a tileset."""
    for child in tile.get("children", []):
        yield from leaves(child, folder)
    if "children" not in tile:
        yield tsdfuse.Mesh.read(folder / tile["content"]["uri"]).vertices


def cells(output: Path) -> dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]]:
    """The vertices of each cell's tiles, and their origin in the world."""
    found = {}
    for path in output.glob("*/tileset.json"):
        tileset = json.loads(path.read_text())
        vertices = np.concatenate(list(leaves(tileset["root"], path.parent)))
        origin = np.array(tileset["root"]["transform"])[12:15]
        found[tuple(map(int, path.parent.name.split("_")))] = vertices, origin
    return found


def among(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether each point is one of the others, up to the rounding of float32: equal in one of eight lattices of 1 mm, each shifted by half."""
    found = np.zeros(len(points), dtype=bool)
    for shift in np.ndindex(2, 2, 2):
        rows = [np.floor(v / 0.001 + 0.5 * np.array(shift)).astype(np.int64) for v in (points, others)]
        kind = np.dtype((np.void, 24))
        found |= np.isin(*(np.ascontiguousarray(r).view(kind).ravel() for r in rows))
    return found


def test_methods_that_add_give_the_bits_of_one_machine(
    cluster: None, log: Path, whole: tsdfuse.Map, tmp_path: Path
) -> None:
    report = tsdfuse.ray.fuse(log, tmp_path / "city/tileset.json", method="raycast", report=tmp_path / "r.json", **SMALL)
    assert report["additive"] and report["spans"] == 3 and report["scans"] == 12 and report["limited_voxels"] == 0
    assert united(tmp_path / "city.work") == whole and report["blocks"] == whole.blocks
    assert json.loads((tmp_path / "r.json").read_text())["cells"] == report["cells"] > 4
    # Nothing is left that is not a result.
    assert not [path for path in tmp_path.rglob(".*") if path.is_file()]
    # The same surface, without seams.
    records = [json.loads(path.read_text()) for path in (tmp_path / "city.work/records/tile").glob("*.json")]
    mesh = whole.mesh()
    assert sum(record["tiles"]["triangles"] for record in records) == len(mesh.triangles)
    tiles = cells(tmp_path / "city")
    used = np.zeros(len(mesh.vertices), dtype=bool)
    for vertices, origin in tiles.values():
        # Each vertex is one of the whole surface: so neighbours meet.
        assert among(vertices + origin, mesh.vertices).all()
        assert not among(vertices + origin + 0.005, mesh.vertices).all()
        used |= among(mesh.vertices, vertices + origin)
    assert used.all()
    tileset = json.loads((tmp_path / "city/tileset.json").read_text())
    uris = [node["content"]["uri"] for node in nodes(tileset["root"]) if "content" in node]
    assert len(uris) == len(set(uris)) == len(tiles) and all((tmp_path / "city" / uri).exists() for uri in uris)
    for node in nodes(tileset["root"]):
        assert all(child["geometricError"] <= node["geometricError"] for child in node.get("children", []))
        box = node["boundingVolume"]["box"]
        middle, half = np.array(box[:3]), np.array([box[3], box[7], box[11]])
        for cell, (vertices, origin) in tiles.items():
            if node.get("content", {}).get("uri", "").startswith("_".join(map(str, cell)) + "/"):
                assert (np.abs(vertices + origin - middle) <= half + 1e-3).all()


def nodes(tile: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield tile
    for child in tile.get("children", []):
        yield from nodes(child)


def test_methods_that_erase_give_the_bits_of_one_machine(cluster: None, log: Path, tmp_path: Path) -> None:
    some: dict[str, Any] = {"scans": "0..8", "method": "patch", **OPTIONS}
    report = tsdfuse.ray.fuse(log, tmp_path / "city/tileset.json", span=3, cell=4, memory_per_task="200M", **some)
    assert not report["additive"] and report["scans"] == 8
    tsdfuse.fuse(log, save_map=tmp_path / "a.tsdf", config={"patch.agreement": False, "moving.leave_out": False}, **some)
    one = tsdfuse.Map.load(tmp_path / "a.tsdf")
    assert united(tmp_path / "city.work") == one
    # Sums of parts would be another map: it matters that nothing is added here.
    halves = [tsdfuse.Map(**OPTIONS) for _ in range(2)]
    for number, scan in enumerate(tsdfuse.open(log).select({"to": 8})):
        halves[number // 4].fuse(scan)
    halves[0].merge(halves[1])
    assert halves[0] != one


def test_a_driver_that_is_started_again_does_nothing_twice(
    cluster: None, log: Path, whole: tsdfuse.Map, tmp_path: Path
) -> None:
    class Stopped(Exception):
        pass

    def stop(done: int, total: int | None, what: str) -> None:
        if what.startswith("merge") and done == 3:
            raise Stopped

    again: dict[str, Any] = {"method": "raycast", **SMALL}
    output = tmp_path / "city/tileset.json"
    with pytest.raises(Stopped):
        tsdfuse.ray.fuse(log, output, progress=stop, **again)
    report = tsdfuse.ray.fuse(log, output, **again)
    before = {phase["phase"]: phase["done_before"] for phase in report["phases"]}
    tasks = {phase["phase"]: phase["tasks"] for phase in report["phases"]}
    assert before["fuse"] == tasks["fuse"] == 3 and 3 <= before["merge-0"] < tasks["merge-0"] and before["tile"] == 0
    assert united(tmp_path / "city.work") == whole
    # A record that is missing is made again, and it and its files are the same.
    files = {path: path.read_bytes() for path in (tmp_path / "city.work").rglob("*.[ts]*") if path.suffix in (".tsdf", ".skin")}
    records = tmp_path / "city.work/records"
    (records / "fuse" / "00000-0000005.json").unlink()
    for record in (records / "merge-0").glob("*.json"):
        record.unlink()
    report = tsdfuse.ray.fuse(log, output, **again)
    assert [phase["tasks"] - phase["done_before"] for phase in report["phases"]] == [0, 1, tasks["merge-0"], 0]
    assert {path: path.read_bytes() for path in files} == files
    # A folder belongs to one job.
    with pytest.raises(tsdfuse.ConfigError, match="differs in asked"):
        tsdfuse.ray.fuse(log, output, method="normals", **SMALL)


def test_many_parts_are_added_by_a_tree(cluster: None, log: Path, whole: tsdfuse.Map, tmp_path: Path) -> None:
    # Two logs, one scan in a span, and a memory so small that each scan is written at once.
    halves = [tmp_path / "a.work", tmp_path / "b.work"]
    report = tsdfuse.ray.fuse(
        log, tmp_path / "a/tileset.json", method="raycast", **{**SMALL, "span": 1, "memory_per_task": "1M"}
    )
    assert [phase["phase"] for phase in report["phases"]] == ["look", "fuse", "merge-0", "merge-1", "tile"]
    assert united(halves[0]) == whole
    twice = tsdfuse.ray.fuse([log, log], tmp_path / "b/tileset.json", method="raycast", **SMALL)
    assert twice["scans"] == 24 and twice["spans"] == 6
    both = whole.copy()
    both.merge(whole)
    assert united(halves[1]) == both


def test_folders_are_urls(cluster: None, log: Path, whole: tsdfuse.Map, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    url = tmp_path.as_uri()
    tsdfuse.ray.fuse(f"{log.as_uri()}", f"{url}/city/tileset.json", work=f"{url}/work", method="raycast", **SMALL)
    assert united(tmp_path / "work") == whole and (tmp_path / "city/tileset.json").exists()


def worker(task: str) -> int | None:
    """The process that works on a task."""
    for process in Path("/proc").iterdir():
        try:
            if process.name.isdigit() and (process / "cmdline").read_bytes().startswith(f"ray::{task}".encode()):
                return int(process.name)
        except OSError:
            pass
    return None


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for workers in /proc")
def test_killed_workers_are_survived(cluster: None, log: Path, whole: tsdfuse.Map, tmp_path: Path) -> None:
    killed: list[str] = []
    done = threading.Event()

    def kill() -> None:
        for task in ("fuse 00000-0000005", "merge-0 ", "tile "):
            while not done.is_set():
                if pid := worker(task):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(task)
                    break
                time.sleep(0.002)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        tsdfuse.ray.fuse(log, tmp_path / "city/tileset.json", method="raycast", **SMALL)
    finally:
        done.set()
        killer.join()
    assert len(killed) >= 2
    assert united(tmp_path / "city.work") == whole


def test_errors_are_told_before_the_work(cluster: None, log: Path, tmp_path: Path) -> None:
    with pytest.raises(tsdfuse.ConfigError, match="NAME/tileset.json"):
        tsdfuse.ray.fuse(log, tmp_path / "city.ply")
    with pytest.raises(tsdfuse.ConfigError, match="poses are known"):
        tsdfuse.ray.fuse(log, tmp_path / "a/tileset.json", poses="track")
    with pytest.raises(tsdfuse.ConfigError, match="form=streaming"):
        tsdfuse.ray.fuse(log, tmp_path / "b/tileset.json", method="roldao", config={"roldao.form": "batch"})
    with pytest.raises(FileNotFoundError):
        tsdfuse.ray.fuse(tmp_path / "none", tmp_path / "c/tileset.json")


def test_a_node_that_leaves_is_survived(log: Path, whole: tsdfuse.Map, tmp_path: Path) -> None:
    from ray.cluster_utils import Cluster

    ray.shutdown()
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    leaving = nodes.add_node(num_cpus=1)
    ray.init(address=nodes.address, log_to_driver=False)
    gone: list[str] = []

    def leave(done: int, total: int | None, what: str) -> None:
        if what.startswith("fuse") and not gone:
            nodes.remove_node(leaving, allow_graceful=False)
            gone.append(what)

    try:
        tsdfuse.ray.fuse(log, tmp_path / "city/tileset.json", method="raycast", progress=leave, **{**SMALL, "span": 2})
    finally:
        ray.shutdown()
        nodes.shutdown()
    assert gone and united(tmp_path / "city.work") == whole


def test_the_command(log: Path, whole: tsdfuse.Map, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tsdfuse.ray", "fuse", str(log), "-o", str(tmp_path / "city/tileset.json")]
    command += ["--span", "5", "--cell", "4", "--memory-per-task", "200M", "--method", "raycast", "--voxel-size", "0.1"]
    command += ["--set", "map.truncation_m=0.3", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scans"] == 12
    assert united(tmp_path / "city.work") == whole
    wrong = subprocess.run([*command[:3], "fuse", str(log), "-o", "x.ply"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2 and "NAME/tileset.json" in wrong.stderr


def test_an_object_store_holds_everything(log: Path, whole: tsdfuse.Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = pytest.importorskip("moto.server").ThreadedMotoServer(port=0)
    s3fs = pytest.importorskip("s3fs")
    server.start()
    host, port = server.get_host_and_port()
    told = {"FSSPEC_S3_ENDPOINT_URL": f"http://{host}:{port}", "FSSPEC_S3_KEY": "a", "FSSPEC_S3_SECRET": "b"}
    ray.shutdown()
    try:
        store = s3fs.S3FileSystem(endpoint_url=told["FSSPEC_S3_ENDPOINT_URL"], key="a", secret="b", skip_instance_cache=True)
        store.mkdir("bucket")
        store.put(str(log), "bucket/log", recursive=True)
        # fsspec reads its environment when it is loaded: here, and in the workers.
        import fsspec

        monkeypatch.setitem(fsspec.config.conf, "s3", {"endpoint_url": told["FSSPEC_S3_ENDPOINT_URL"], "key": "a", "secret": "b"})
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, runtime_env={"env_vars": told})
        again: dict[str, Any] = {"work": "s3://bucket/work", "method": "raycast", **SMALL}
        report = tsdfuse.ray.fuse("s3://bucket/log", "s3://bucket/city/tileset.json", **again)
        assert report["additive"] and report["scans"] == 12
        # A second call finds all of it.
        again_told = tsdfuse.ray.fuse("s3://bucket/log", "s3://bucket/city/tileset.json", **again)
        assert all(phase["done_before"] == phase["tasks"] for phase in again_told["phases"])
        store.invalidate_cache()
        store.get("bucket/work", str(tmp_path / "work"), recursive=True)
        assert united(tmp_path / "work") == whole
        tileset = json.loads(store.cat("bucket/city/tileset.json"))
        uris = [node["content"]["uri"] for node in nodes(tileset["root"]) if "content" in node]
        assert uris and all(store.exists(f"bucket/city/{uri}") for uri in uris)
    finally:
        ray.shutdown()
        server.stop()
