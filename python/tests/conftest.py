"""What tests share: small scenes, and the sample of the repository."""

from __future__ import annotations

from pathlib import Path

import pytest
import tsdfuse

ROOT = Path(__file__).resolve().parents[2]
OPTIONS = {"voxel_size": 0.1, "truncation": 0.3}


@pytest.fixture(scope="session")
def sample() -> Path:
    """Three real scans."""
    return ROOT / "sample" / "pandaset-002"


@pytest.fixture(scope="session")
def room() -> tsdfuse.Simulation:
    """Twelve simulated scans of a hall."""
    return tsdfuse.simulate("hall", sensor="vlp16", scans=12)


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as a folder."""
    folder = tmp_path_factory.mktemp("logs") / "hall"
    tsdfuse.simulate("hall", folder, sensor="vlp16", scans=12)
    return folder


@pytest.fixture
def fused(room: tsdfuse.Simulation) -> tsdfuse.Map:
    """A map of them."""
    made = tsdfuse.Map(method="raycast", **OPTIONS)
    for scan in room:
        made.fuse(scan)
    return made
