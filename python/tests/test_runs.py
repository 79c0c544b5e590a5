"""Whole runs, sessions, evaluation, the command."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tsdfuse

OPTIONS = {"voxel_size": 0.1, "truncation": 0.3}


def test_a_run_tells_how_far_it_is(log: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int | None, str]] = []
    report = tsdfuse.fuse(
        log, tmp_path / "a.ply", scans=slice(0, 10, 2), preview=tmp_path / "a.png", report=tmp_path / "a.json",
        progress=lambda *news: told.append(news), **OPTIONS,
    )  # fmt: skip
    assert report["totals"]["scans"] == 5 and json.loads((tmp_path / "a.json").read_text())["mesh"] == report["mesh"]
    assert [done for done, total, _ in told if total == 5][-1] == 5
    assert "extracting the surface" in [what for _, _, what in told]
    assert (tmp_path / "a.png").read_bytes()[1:4] == b"PNG"


def test_all_ways_give_the_same_map(log: Path, room: tsdfuse.Simulation, tmp_path: Path) -> None:
    tsdfuse.fuse(log, save_map=tmp_path / "a.tsdf", **OPTIONS)
    whole = tsdfuse.Map.load(tmp_path / "a.tsdf")
    stored = tsdfuse.fuse(log, tmp_path / "b.ply", store=tmp_path / "b.store", memory="1M", commit_every=3, **OPTIONS)
    assert stored["paging"]["commits"] > 3
    store = tsdfuse.Store(tmp_path / "b.store")
    assert store.map() == tsdfuse.Map.load(tmp_path / "b.store") == whole and store.blocks == whole.blocks
    assert store.write_mesh(tmp_path / "c.ply")["triangles"] == len(whole.mesh().triangles)
    opened = tsdfuse.open(log)
    with tsdfuse.session(opened, follow_every=4, **OPTIONS) as session:
        while session.step():
            pass
        assert session.map() == whole
    assert sum(len(changes) for changes in session.changes()) > 0
    assert len(session.mesh().triangles) == len(whole.mesh().triangles) and session.done == 12
    with tsdfuse.session(sensor="vlp16", store=tmp_path / "d.store", **OPTIONS) as pushed:
        for scan in room:
            pushed.fuse(scan)
    assert pushed.report()["map"]["blocks"] == whole.blocks
    pushed.close()
    assert tsdfuse.Map.load(tmp_path / "d.store") == whole
    with pytest.raises(tsdfuse.ConfigError, match="closed"):
        pushed.fuse(room[0])


def test_a_run_that_was_stopped_goes_on(log: Path, tmp_path: Path) -> None:
    def stop(done: int, total: int | None, what: str) -> None:
        if done >= 4:
            raise KeyboardInterrupt

    store = tmp_path / "a.store"
    slow = {"voxel_size": 0.05, "truncation": 0.2}
    with pytest.raises(KeyboardInterrupt):
        tsdfuse.fuse(log, store=store, commit_every=1, progress=stop, **slow)
    assert 4 <= tsdfuse.Store(store).integrations < 12
    report = tsdfuse.resume(store)
    assert report["totals"]["scans"] == 12
    tsdfuse.fuse(log, save_map=tmp_path / "whole.tsdf", **slow)
    assert tsdfuse.Map.load(store) == tsdfuse.Map.load(tmp_path / "whole.tsdf")


def test_meshes_and_methods_are_compared(log: Path, fused: tsdfuse.Map, room: tsdfuse.Simulation) -> None:
    mesh, truth = fused.mesh(), room.mesh()
    by_mesh = tsdfuse.compare(mesh, truth, samples=20_000)
    by_file = tsdfuse.compare(mesh, log / "scene.ply", samples=20_000)
    assert by_mesh["all"]["mesh_to_reference"]["mean_m"] < 0.05
    assert abs(by_mesh["all"]["mesh_to_reference"]["mean_m"] - by_file["all"]["mesh_to_reference"]["mean_m"]) < 1e-6
    cloud = tsdfuse.compare(mesh, room[0].points_in_world(), samples=20_000)
    assert cloud["inputs"]["reference"] == "cloud"
    steps: list[str] = []
    report = tsdfuse.evaluate(
        log, ["raycast", "patch"], samples=20_000, progress=lambda done, total, what: steps.append(what), **OPTIONS
    )
    names = [row["name"] for row in report["methods"]]
    assert names == ["raycast", "patch"] and "patch" in steps
    assert all(row["peak_memory_bytes"] > 0 for row in report["methods"])


def test_the_command_is_there(log: Path, tmp_path: Path) -> None:
    def call(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "tsdfuse", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    assert call("--version").stdout.strip() == f"tsdfuse {tsdfuse.__version__}"
    done = call("fuse", log, "-o", tmp_path / "a.ply", "--voxel-size", 0.2, "--truncation", 0.6, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["totals"]["scans"] == 12 and report["command_line"][:2] == ["tsdfuse", "fuse"]
    missing = call("fuse", tmp_path / "none", "-o", tmp_path / "b.ply")
    assert missing.returncode == 1 and "none: No such file" in missing.stderr
    assert call("fuse").returncode == 2
    # Methods run in processes of their own, which this interpreter starts.
    evaluated = call("evaluate", log, "--methods", "raycast", "--runs", 1, "--samples", 20000, "--voxel-size", 0.2,
                     "--truncation", 0.6, "--json")  # fmt: skip
    assert evaluated.returncode == 0, evaluated.stderr
    assert json.loads(evaluated.stdout)["methods"][0]["peak_memory_bytes"] > 0


def test_tiles_are_written(fused: tsdfuse.Map, tmp_path: Path) -> None:
    report = fused.write_mesh(tmp_path / "tiles" / "tileset.json")
    assert report["triangles"] == len(fused.mesh().triangles)
    assert json.loads((tmp_path / "tiles" / "tileset.json").read_text())["asset"]["version"] == "1.1"


def test_oddities_are_logged(log: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="tsdfuse"):
        tsdfuse.fuse(log, tmp_path / "a.ply", scans="0..99", **OPTIONS)
    assert "there are only 12 scans" in caplog.text


def test_refined_poses_are_better(log: Path, room: tsdfuse.Simulation, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    noisy = room.poses.copy()
    noisy[:, :3, 3] += rng.normal(0, 0.03, (12, 3))
    tsdfuse.Trajectory(noisy).write(tmp_path / "noisy.txt")
    refined = tsdfuse.odometry(log, refine=True, poses=tmp_path / "noisy.txt")

    def error(poses: np.ndarray) -> float:
        truth = tsdfuse.Trajectory(room.poses)
        return tsdfuse.compare_trajectories(tsdfuse.Trajectory(poses), truth)["absolute_m"]["rmse"]

    assert error(refined.poses) < 0.6 * error(noisy)
