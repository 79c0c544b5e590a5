"""Clouds of a ROS bag, read by rosbags, with poses of your own: pip install rosbags

tsdfuse reads bags by itself, with tf, odometry and times of points: tsdfuse.open("drive.bag"). This is for those whose poses come from
elsewhere.

    python from_rosbags.py BAG TOPIC poses.tum mesh.ply
"""

import sys
from pathlib import Path

import numpy as np
import tsdfuse
from rosbags.highlevel import AnyReader


def points(message) -> np.ndarray:
    """x, y, z of a PointCloud2."""
    offsets = {field.name: field.offset for field in message.fields}
    kind = np.dtype(
        {"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [offsets[n] for n in "xyz"], "itemsize": message.point_step}
    )
    cloud = np.frombuffer(message.data, kind)
    return np.column_stack([cloud["x"], cloud["y"], cloud["z"]])


def main(bag: str, topic: str, poses: str, output: str) -> None:
    times, matrices = tsdfuse.Trajectory.read(poses)
    made = tsdfuse.Map(voxel_size=0.1, truncation=0.3)
    with AnyReader([Path(bag)]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, raw in reader.messages(connections):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            nearest = np.abs(times - stamp).argmin()
            if abs(times[nearest] - stamp) < 50_000_000:
                made.fuse(points(message), matrices[nearest], time_ns=stamp)
    made.mesh().write(output)
    print(made)


if __name__ == "__main__":
    main(*sys.argv[1:])
