"""The surface as an Open3D mesh, cleaned there: pip install open3d

    python with_open3d.py LOG mesh.ply
"""

import sys

import numpy as np
import open3d
import tsdfuse


def main(log: str, output: str) -> None:
    made = tsdfuse.Map(voxel_size=0.1, truncation=0.3)
    for scan in tsdfuse.open(log):
        made.fuse(scan)
    mesh = made.mesh().to_open3d()
    clusters, sizes, _ = mesh.cluster_connected_triangles()
    small = np.asarray(sizes)[np.asarray(clusters)] < 200
    mesh.remove_triangles_by_mask(small)
    mesh.remove_unreferenced_vertices()
    open3d.io.write_triangle_mesh(output, mesh)
    print(f"{small.sum()} triangles of small pieces removed, {len(mesh.triangles)} are left")


if __name__ == "__main__":
    main(*sys.argv[1:])
