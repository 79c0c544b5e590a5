"""Writes LAS, LAZ and E57 with PyPI's laspy and pye57, of the scene of make.py: python surveys.py"""

import os

import laspy
import numpy as np
import pye57

from make import HERE, N, START_NS, WORLD, body, inside, quaternion, tum, write

os.makedirs(f"{HERE}/surveys/scans", exist_ok=True)
EAST = np.array([690_000.0, 5_334_000.0, 500.0])
START = START_NS / 1e9 - 1.59e9

# Three tenths of a second, each with all points, in the order of time; the clock is that of the trajectory.
world = np.vstack([WORLD + EAST] * 3)
secs = START + np.concatenate([0.1 * k + np.linspace(0.005, 0.095, N) for k in range(3)])


def survey(name, version, form, order):
    header = laspy.LasHeader(version=version, point_format=form)
    header.scales, header.offsets = np.full(3, 0.0001), EAST
    las = laspy.LasData(header)
    las.x, las.y, las.z = world[order].T
    las.intensity = np.arange(3 * N)[order]
    if "gps_time" in las.point_format.dimension_names:
        las.gps_time = secs[order]
    las.write(f"{HERE}/surveys/{name}")


straight = np.arange(3 * N)
mixed = np.argsort(np.arange(3 * N) % 7, kind="stable")
survey("drive.las", "1.2", 1, straight)
survey("drive.laz", "1.4", 6, straight)
survey("mixed.laz", "1.2", 3, mixed)
survey("untimed.las", "1.2", 0, straight)
poses = ""
for k in range(-4, 12):
    pose = body(0.05 * k)
    pose[:3, 3] += EAST
    poses += tum(0, pose, time=f"{START + 0.05 * k:.9f}") + "\n"
write("surveys/trajectory.txt", poses)

# Clouds in the scanner's frame, one a file.
for k in range(2):
    header = laspy.LasHeader(version="1.2", point_format=0)
    header.scales = np.full(3, 0.0001)
    las = laspy.LasData(header)
    las.x, las.y, las.z = inside(body(0.1 * k), WORLD).T
    las.write(f"{HERE}/surveys/scans/{k}.laz")
write("surveys/scans/poses.txt", "".join(" ".join(repr(float(v)) for v in body(0.1 * k)[:3].ravel()) + "\n" for k in range(2)))

path = f"{HERE}/surveys/two.e57"
if os.path.exists(path):
    os.remove(path)
e57 = pye57.E57(path, mode="w")
for k in range(2):
    pose = body(0.1 * k)
    pose[:3, 3] += EAST
    points = inside(body(0.1 * k), WORLD)
    x, y, z, w = quaternion(pose)
    raw = {"cartesianX": points[:, 0], "cartesianY": points[:, 1], "cartesianZ": points[:, 2], "intensity": np.arange(N, dtype=np.float32)}
    e57.write_scan_raw(raw, name=f"station {k}", rotation=np.array([w, x, y, z]), translation=pose[:3, 3])
e57.close()
