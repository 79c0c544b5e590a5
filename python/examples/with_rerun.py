"""The surface as it grows, in rerun: pip install rerun-sdk. Only what changed is sent.

    python with_rerun.py LOG street.rrd && rerun street.rrd
"""

import sys

import rerun as rr
import tsdfuse


def main(log: str, output: str) -> None:
    rr.init("tsdfuse")
    rr.save(output)
    rr.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    made = tsdfuse.Map(voxel_size=0.2, truncation=0.6)
    for number, scan in enumerate(tsdfuse.open(log)):
        rr.set_time("scan", sequence=number)
        made.fuse(scan)
        rr.log("world/scan", rr.Points3D(scan.points_in_world(), radii=0.02))
        for block, piece in made.changes():
            name = "world/surface/" + "_".join(map(str, block))
            if len(piece.vertices):
                rr.log(
                    name,
                    rr.Mesh3D(
                        vertex_positions=piece.vertices, triangle_indices=piece.triangles, vertex_normals=piece.normals
                    ),
                )
            else:
                rr.log(name, rr.Clear(recursive=False))
    print(made)


if __name__ == "__main__":
    main(*sys.argv[1:])
