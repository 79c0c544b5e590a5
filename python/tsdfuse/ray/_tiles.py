"""One tileset over those of all cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__

Box = NDArray[np.float64]


def corners(root: dict[str, Any]) -> Box:
    """The lowest and the highest corner (2, 3) of a cell's surface, world, metres."""
    box, transform = np.array(root["box"]), np.array(root["transform"])
    middle, half = box[:3] + transform[12:15], box[[3, 7, 11]]
    return np.array([middle - half, middle + half])


def volume(bounds: Box) -> dict[str, list[float]]:
    middle, half = bounds.mean(axis=0), (bounds[1] - bounds[0]) / 2
    return {"box": [*middle.tolist(), half[0], 0, 0, 0, half[1], 0, 0, 0, half[2]]}


def node(cells: dict[tuple[int, int, int], tuple[str, dict[str, Any]]], edge: int) -> dict[str, Any]:
    """Cells within a square of ``edge`` cells along x and y: one tile, or its four quarters."""
    bounds = [corners(root) for _, root in cells.values()]
    whole = np.array([np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)])
    told: dict[str, Any] = {"boundingVolume": volume(whole)}
    if len(cells) == 1:
        ((name, root),) = cells.values()
        return {**told, "geometricError": root["error"], "content": {"uri": f"{name}/tileset.json"}}
    if edge <= 1:  # one above the other
        children = [node({cell: found}, 1) for cell, found in cells.items()]
    else:
        half = edge // 2
        quarters: dict[tuple[int, int], dict[tuple[int, int, int], tuple[str, dict[str, Any]]]] = {}
        for cell, found in cells.items():
            quarters.setdefault((cell[0] // half, cell[1] // half), {})[cell] = found
        children = [node(quarter, half) for _, quarter in sorted(quarters.items())]
        if len(children) == 1:
            return children[0]
    # Nothing is shown in place of its children: the error is that of showing nothing.
    error = max(float(np.linalg.norm(whole[1] - whole[0])), *(child["geometricError"] for child in children))
    return {**told, "geometricError": error, "refine": "ADD", "children": children}


def tileset(roots: dict[str, tuple[list[int], dict[str, Any]]]) -> dict[str, Any]:
    """A tileset of tilesets; by the name of each cell its place and its root."""
    cells = {(cell[0], cell[1], cell[2]): (name, root) for name, (cell, root) in roots.items()}
    span = 1 + max(abs(x) for cell in cells for x in cell[:2])
    edge = 1 << (2 * span).bit_length()
    root = node({(x + edge // 2, y + edge // 2, z): found for (x, y, z), found in cells.items()}, edge)
    return {
        "asset": {"version": "1.1", "generator": f"tsdfuse {__version__}"},
        "geometricError": root["geometricError"],
        "root": {"refine": "ADD", **root},
    }
