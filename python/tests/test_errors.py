"""Exceptions: of fitting classes, with one clear sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import numpy as np
import pickle
import pytest
import tsdfuse

EYE = np.eye(4)


@pytest.mark.parametrize(
    ("error", "message", "cause"),
    [
        (FileNotFoundError, "No such file or directory: 'nowhere'", lambda: tsdfuse.open("nowhere")),
        (FileNotFoundError, "none.tsdf", lambda: tsdfuse.Map.load("none.tsdf")),
        (ValueError, "voxel_size_m must be a positive length", lambda: tsdfuse.Map(voxel_size=-1)),
        (tsdfuse.ConfigError, "no option voxels; there are method, voxel_size", lambda: tsdfuse.Map(voxels=1)),
        (tsdfuse.ConfigError, "unknown variant `best`", lambda: tsdfuse.Map(method="best")),
        (tsdfuse.ConfigError, "unknown field `far`", lambda: tsdfuse.Config({"range.far": 1})),
        (tsdfuse.ConfigError, "no sensor vlp17; there are", lambda: tsdfuse.Map(sensor="vlp17")),
        (tsdfuse.ConfigError, r"points must have the shape \(N, 3\)", lambda: tsdfuse.Map().fuse(np.zeros((5, 2)), EYE)),
        (tsdfuse.ConfigError, "pose: the pose is not rigid", lambda: tsdfuse.Map().fuse(np.ones((5, 3)), 2 * EYE + np.diag([0, 0, 0, -1]))),
        (tsdfuse.ConfigError, "last row", lambda: tsdfuse.Map().fuse(np.ones((5, 3)), 2 * EYE)),
        (tsdfuse.BadScanError, "has no pose", lambda: tsdfuse.Map(method="raycast").fuse(np.ones((5, 3)))),
        (tsdfuse.BadScanError, "5 points but 4 rings", lambda: tsdfuse.Scan(np.ones((5, 3)), EYE, rings=np.zeros(4))),
        (tsdfuse.BadScanError, "such times must be finite", lambda: tsdfuse.Scan(np.ones((1, 3)), EYE, times=[0], motion=([0.0], EYE[None]))),
        (TypeError, "a Scan has its own pose", lambda: tsdfuse.Map().fuse(tsdfuse.Scan(np.ones((5, 3)), EYE), EYE)),
        (tsdfuse.EmptyResultError, "the map has no surface", lambda: tsdfuse.Map().render()),
        (tsdfuse.ConfigError, "holds nothing", lambda: tsdfuse.Map().box([1, 0, 0], [0, 1, 1])),
        (tsdfuse.ConfigError, "there is no vertex 7 of 3", lambda: tsdfuse.Mesh(np.zeros((3, 3)), [[0, 1, 7]])),
        (tsdfuse.ConfigError, "selects nothing", lambda: tsdfuse.fuse("x", "y.ply", scans="9..3")),
        (tsdfuse.ConfigError, "a size is wanted", lambda: tsdfuse.fuse("x", "y.ply", memory="much")),
        (tsdfuse.ConfigError, "no scene moon; there are", lambda: tsdfuse.simulate("moon")),
        (tsdfuse.ConfigError, "no protocol x", lambda: tsdfuse.compare(tsdfuse.Mesh(np.zeros((3, 3)), [[0, 1, 2]]), "a", protocol="x")),
    ],
)  # fmt: skip
def test_errors(error: type[Exception], message: str, cause: Callable[[], Any]) -> None:
    with pytest.raises(error, match=message) as raised:
        cause()
    assert "\n" not in str(raised.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "a.tsdf").write_bytes(b"this is no map at all, but long enough to be read as one")
    with pytest.raises(tsdfuse.FormatError, match=r"a\.tsdf"):
        tsdfuse.Map.load(tmp_path / "a.tsdf")
    with pytest.raises(tsdfuse.FormatError, match="holds no scans"):
        tsdfuse.open(tmp_path)
    with pytest.raises(tsdfuse.StoreError, match=r"a\.tsdf"):
        tsdfuse.Store(tmp_path / "a.tsdf")
    with pytest.raises(tsdfuse.Error):
        tsdfuse.resume(tmp_path / "a.tsdf")


def test_a_bad_scan_leaves_the_map_as_it_was(fused: tsdfuse.Map) -> None:
    before = fused.copy()
    with pytest.raises(tsdfuse.BadScanError):
        fused.fuse(np.full((5, 3), 3.0), None)
    assert fused == before


def test_a_map_is_not_merged_into_itself(fused: tsdfuse.Map) -> None:
    with pytest.raises(tsdfuse.ConfigError, match="into itself"):
        fused.merge(fused)


def test_an_exception_of_a_callback_is_raised(log: Path, tmp_path: Path) -> None:
    def fails(done: int, total: int | None, what: str) -> None:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        tsdfuse.fuse(log, tmp_path / "a.ply", progress=fails)


def test_logs_say_why_they_are_not_pickled(sample: Path) -> None:
    with pytest.raises(tsdfuse.ConfigError, match="pickle its path"):
        pickle.dumps(tsdfuse.open(sample))


def test_configs_are_layered_and_pickled(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("method = 'raycast'\n[map]\nvoxel_size_m = 0.2\ntruncation_m = 0.8\n")
    config = tsdfuse.Config(tmp_path / "run.toml", truncation=0.5)
    assert config["map"]["voxel_size_m"] == 0.2 and config["map.truncation_m"] == 0.5
    assert config.settings() == {"method": "raycast", "map": {"voxel_size_m": 0.2, "truncation_m": 0.5}}
    again = pickle.loads(pickle.dumps(config))
    assert again == config == tsdfuse.Config(config) != tsdfuse.Config()
    assert tsdfuse.Config({"map": {"voxel_size_m": 0.2}, "patch.carve": False})["patch.carve"] is False
    with pytest.raises(tsdfuse.ConfigError, match="expected one of"):
        tsdfuse.Config({"patch.curve": False})
