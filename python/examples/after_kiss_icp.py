"""KISS-ICP finds the poses, tsdfuse makes the surface: pip install kiss-icp

    python after_kiss_icp.py LOG mesh.ply
"""

import sys

import numpy as np
import tsdfuse
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP


def main(log: str, output: str) -> None:
    config = KISSConfig()
    config.mapping.voxel_size = 0.5
    odometry, made = KissICP(config), tsdfuse.Map(voxel_size=0.1, truncation=0.3)
    for scan in tsdfuse.open(log):
        points = scan.points.astype(np.float64)
        times = np.zeros(len(points)) if scan.times is None else scan.times.astype(np.float64)
        # What it returns is undistorted: as seen all at once from the pose that it found.
        undistorted, _ = odometry.register_frame(points, times)
        made.fuse(undistorted, odometry.last_pose)
    made.mesh().write(output)
    print(made)


if __name__ == "__main__":
    main(*sys.argv[1:])
