"""Meshes for other libraries."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._core import Changes, Mesh


def open3d_mesh(mesh: Mesh) -> Any:
    """An ``open3d.geometry.TriangleMesh``."""
    import open3d

    made = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.triangles)
    )
    if len(mesh.normals):
        made.vertex_normals = open3d.utility.Vector3dVector(mesh.normals)
    return made


def trimesh_mesh(mesh: Mesh) -> Any:
    """A ``trimesh.Trimesh``, its vertices as they are."""
    import trimesh

    normals = mesh.normals if len(mesh.normals) else None
    return trimesh.Trimesh(vertices=mesh.vertices, faces=mesh.triangles, vertex_normals=normals, process=False)


def pieces(changes: Changes) -> Iterator[tuple[tuple[int, int, int], Mesh]]:
    """Each block whose surface changed, with its surface now."""
    from ._core import Mesh

    for number, (x, y, z) in enumerate(changes.blocks.tolist()):
        vertices = slice(*changes.vertex_offsets[number : number + 2])
        triangles = slice(*changes.triangle_offsets[number : number + 2])
        yield (x, y, z), Mesh(changes.vertices[vertices], changes.triangles[triangles], changes.normals[vertices])
