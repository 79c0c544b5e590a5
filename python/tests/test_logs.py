"""Logs, scans, trajectories."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import tsdfuse


def test_a_log_is_a_sequence_of_scans(sample: Path) -> None:
    log = tsdfuse.open(sample)
    assert len(log) == 3 and log.poses.shape == (3, 4, 4) and log.times_ns.dtype == np.int64
    clean = list(log)
    raw = [log[i] for i in range(len(log))]
    assert [scan.name for scan in clean] == [scan.name for scan in raw] == log.names
    assert len(clean[0]) < len(raw[0]) == len(clean[0]) + sum(clean[0].dropped.values()) - sum(raw[0].dropped.values())
    assert np.array_equal(raw[0].cleaned_by().points, clean[0].points)
    assert np.array_equal(log[-1].pose, log.poses[-1])
    assert [scan.name for scan in log.select({"from": 1, "step": 1})] == log.names[1:]
    assert log.sensors[0]["model"]["name"] == "pandar64" == clean[0].sensor
    assert log.guess_sensor()["name"] == "pandar64"
    times, poses = log.trajectory
    assert len(times) == len(poses)
    with pytest.raises(IndexError, match="no scan 3"):
        log[3]


def test_motion_is_undone(room: tsdfuse.Simulation) -> None:
    moving = tsdfuse.simulate("hall", sensor="vlp16", scans=2, motion=True, noise=0.0)
    scan = moving[0]
    secs, poses = scan.motion
    assert poses.shape == (len(secs), 4, 4) and scan.times.shape == (len(scan),)
    world = scan.points_in_world()
    assert np.abs(moving.distance(world)).max() < 1e-3
    still = scan.undistorted()
    assert still.motion is None
    assert np.allclose(still.points @ scan.pose[:3, :3].T + scan.pose[:3, 3], world, atol=1e-4)
    again = tsdfuse.Scan(scan.points, scan.pose, times=scan.times, motion=scan.motion)
    assert np.allclose(again.points_in_world(), world)
    elsewhere = np.eye(4)
    elsewhere[:3, 3] = 5, 0, 0
    assert np.allclose(room[0].with_pose(elsewhere).points_in_world(), room[0].points + [5, 0, 0], atol=1e-5)


def test_scans_of_arrays_are_pickled() -> None:
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    scan = tsdfuse.Scan(points, np.eye(4), rings=np.arange(10), time_ns=7, name="a")
    again = pickle.loads(pickle.dumps(scan))
    assert np.array_equal(again.points, points) and again.time_ns == 7 and again.name == "a"
    assert again.rings.dtype == np.uint16 and np.array_equal(again.pose, np.eye(4))


def test_trajectories_are_read_written_compared(tmp_path: Path, room: tsdfuse.Simulation) -> None:
    trajectory = tsdfuse.Trajectory(room.poses, np.arange(12) * 100_000_000 + 10**18)
    trajectory.write(tmp_path / "a.tum")
    again = tsdfuse.Trajectory.read(tmp_path / "a.tum")
    assert np.array_equal(again.times_ns, trajectory.times_ns) and np.allclose(again.poses, trajectory.poses)
    assert trajectory.length > 0.5 and len(pickle.loads(pickle.dumps(trajectory))) == 12
    moved = trajectory.poses.copy()
    moved[:, 0, 3] += 1
    compared = tsdfuse.compare_trajectories(tsdfuse.Trajectory(moved, trajectory.times_ns), trajectory)
    assert compared["absolute_m"]["rmse"] < 1e-6
    compared = tsdfuse.compare_trajectories(tsdfuse.Trajectory(moved, trajectory.times_ns), trajectory, align=False)
    assert abs(compared["absolute_m"]["rmse"] - 1) < 1e-6


def test_odometry_finds_the_poses(room: tsdfuse.Simulation, log: Path) -> None:
    (log / "poses.txt").rename(log / "truth.txt")
    try:
        found = tsdfuse.odometry(log)
        times, poses = found
        assert poses.shape == (12, 4, 4) and len(found.quality["scans"]) == 12
    finally:
        (log / "truth.txt").rename(log / "poses.txt")
    truth = np.linalg.inv(room.poses[0]) @ room.poses
    assert np.abs(poses[:, :3, 3] - truth[:, :3, 3]).max() < 0.05
    tracker = tsdfuse.Odometry(config={"odometry.imu": True})
    # A unit at rest: what it tells is used or not, but takes nothing away.
    seconds = np.arange(-0.5, 3, 0.01)
    first = tsdfuse.open(log)[0].time_ns or 0
    rows = np.zeros((len(seconds), 3))
    tracker.push_imu(first + (seconds * 1e9).astype(np.int64), rows, rows + [0, 0, 9.8])
    with pytest.raises(ValueError, match="no samples"):
        tracker.push_imu([1, 2], rows, rows)
    placed = [scan for raw in room for scan, _ in tracker.push(raw.cleaned_by())] + [scan for scan, _ in tracker.finish()]
    found_now = np.array([scan.pose for scan in placed])
    assert np.abs(np.linalg.inv(found_now[0]) @ found_now - np.linalg.inv(poses[0]) @ poses).max() < 0.05


def test_options_of_odometry_and_loops_are_keywords(log: Path, tmp_path: Path) -> None:
    graph = tmp_path / "graph.g2o"
    found = tsdfuse.odometry(
        log, scans="0..6", loops=True, save_graph=graph, min_range=0.6, config={"loops.gap_m": 20, "odometry.imu": False}
    )
    assert len(found) == 6 and graph.read_text().startswith("VERTEX_SE3:QUAT")
    open_ = tsdfuse.odometry(log, scans="0..6", loops=False)
    assert np.abs(open_.poses - found.poses).max() < 0.05
    with pytest.raises(tsdfuse.ConfigError, match="loops"):
        tsdfuse.odometry(log, config={"loops.gap": 20})


def test_simulations_are_what_the_command_writes(room: tsdfuse.Simulation, log: Path) -> None:
    written = tsdfuse.open(log)
    assert len(written) == len(room) == 12
    assert np.array_equal(written[3].points, room[3].points)
    assert len(room.mesh().triangles) > 100 and (log / "scene.ply").exists()
