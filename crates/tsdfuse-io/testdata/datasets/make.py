"""Writes small folders as the makers of data sets lay them out, of one scene: the same points in the world, seen from a body that moves
straight on and turns. `world.txt` has the points. Needs numpy, scipy and pyarrow: python make.py"""

import json
import os
import struct

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
from scipy.spatial.transform import Rotation as R

HERE = os.path.dirname(os.path.abspath(__file__))
rng = np.random.default_rng(7)
N = 40
azimuth, distance = rng.uniform(-np.pi, np.pi, N), rng.uniform(8, 20, N)
WORLD = np.column_stack([distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(-1.5, 3.0, N)]).astype(np.float32).astype(float)
START_NS = 1_600_000_000_000_000_000
STEP_NS = 100_000_000


def matrix(rotation, position):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), position
    return pose


def body(secs):
    """world_from_body: 5 m/s along x, 0.3 rad/s to the left."""
    return matrix(R.from_euler("z", 0.3 * secs), [5.0 * secs, 1.0, 0.2])


def inside(pose, points):
    inverse = np.linalg.inv(pose)
    return points @ inverse[:3, :3].T + inverse[:3, 3]


def seen(secs, body_from_sensor, offsets=None):
    """The points in the sensor's frame, each at its own time."""
    if offsets is None:
        return inside(body(secs) @ body_from_sensor, WORLD)
    return np.array([inside(body(secs + o) @ body_from_sensor, WORLD[i : i + 1])[0] for i, o in enumerate(offsets)])


def quaternion(pose):
    return R.from_matrix(pose[:3, :3]).as_quat()


def write(path, content):
    path = os.path.join(HERE, path)
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "wb") as file:
        file.write(content if isinstance(content, bytes) else content.encode())


def rows(pose):
    return " ".join(repr(float(v)) for v in pose[:3].ravel())


def kitti_bin(points):
    return np.column_stack([points, np.full(N, 0.5)]).astype("<f4").tobytes()


def tum(secs, pose, separator=" ", time=None):
    return separator.join([time or f"{secs:.9f}"] + [repr(float(v)) for v in [*pose[:3, 3], *quaternion(pose)]])


OFFSETS = np.linspace(0.0, 0.09, N)


def nuscenes():
    ego_from_lidar = matrix(R.from_euler("zyx", [-1.57, 0.01, 0.02]), [0.9, 0.0, 1.8])
    tables = {name: [] for name in ["scene", "sample", "sample_data", "calibrated_sensor", "sensor", "ego_pose"]}
    for s, name in enumerate(["scene-0061", "scene-0103"]):
        tables["scene"].append({"token": f"scene{s}", "log_token": "", "nbr_samples": 1, "name": name, "description": ""})
        tables["sample"].append({"token": f"sample{s}", "timestamp": START_NS // 1000, "prev": "", "next": "", "scene_token": f"scene{s}"})
    for sensor, channel in enumerate(["LIDAR_TOP", "CAM_FRONT", "RADAR_FRONT"]):
        tables["sensor"].append({"token": f"sensor{sensor}", "channel": channel, "modality": channel.split("_")[0].lower()})
        x, y, z, w = quaternion(ego_from_lidar)
        intrinsic = [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]] if sensor == 1 else []
        tables["calibrated_sensor"].append({"token": f"calibrated{sensor}", "sensor_token": f"sensor{sensor}", "translation": list(ego_from_lidar[:3, 3]), "rotation": [w, x, y, z], "camera_intrinsic": intrinsic})
    for s in range(2):
        for k in reversed(range(3)):
            for sensor, (folder, end) in enumerate([("LIDAR_TOP", "pcd.bin"), ("CAM_FRONT", "jpg"), ("RADAR_FRONT", "pcd")]):
                token, time = f"data{s}{k}{sensor}", START_NS // 1000 + (k + 10 * s) * STEP_NS // 1000
                pose = body(0.1 * k)
                x, y, z, w = quaternion(pose)
                tables["ego_pose"].append({"token": f"ego{token}", "timestamp": time, "rotation": [w, x, y, z], "translation": list(pose[:3, 3])})
                is_key = k == 0
                name = f"{'samples' if is_key else 'sweeps'}/{folder}/n015__{folder}__{time}.{end}"
                tables["sample_data"].append({"token": token, "sample_token": f"sample{s}", "ego_pose_token": f"ego{token}", "calibrated_sensor_token": f"calibrated{sensor}", "timestamp": time, "fileformat": end, "is_key_frame": is_key, "height": 900 * (sensor == 1), "width": 1600 * (sensor == 1), "filename": name, "prev": "", "next": ""})
                if sensor == 0 and s == 0:
                    points = seen(0.1 * k, ego_from_lidar)
                    ring = np.argsort(np.argsort(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))) * 32 // N
                    write(f"nuscenes/{name}", np.column_stack([points, np.full(N, 9.0), ring]).astype("<f4").tobytes())
    for name, table in tables.items():
        write(f"nuscenes/v1.0-mini/{name}.json", json.dumps(table, indent=0))


def argoverse():
    log = os.path.join(HERE, "argoverse")
    os.makedirs(f"{log}/sensors/lidar", exist_ok=True)
    os.makedirs(f"{log}/calibration", exist_ok=True)
    # Steep and bent, so that only the right frame has constant elevations.
    ego_from = {"up_lidar": matrix(R.from_euler("xyz", [0.3, -0.2, 0.1]), [1.35, 0.0, 1.64]), "down_lidar": matrix(R.from_euler("xyz", [3.1, 0.1, 0.0]), [1.35, 0.0, 1.56])}

    def table(poses, first):
        columns = dict(first)
        for k, name in enumerate(["qw", "qx", "qy", "qz"]):
            columns[name] = [quaternion(p)[(k + 3) % 4] for p in poses]
        for k, name in enumerate(["tx_m", "ty_m", "tz_m"]):
            columns[name] = [p[k, 3] for p in poses]
        return pa.table(columns)

    feather.write_feather(table(ego_from.values(), {"sensor_name": list(ego_from)}), f"{log}/calibration/egovehicle_SE3_sensor.feather", compression="uncompressed")
    secs = np.arange(-2, 8) * 0.05
    times = [START_NS + int(round(s * 1e9)) for s in secs]
    feather.write_feather(table([body(s) for s in secs], {"timestamp_ns": pa.array(times, pa.int64())}), f"{log}/city_SE3_egovehicle.feather", compression="zstd")
    truth = []
    for k in range(3):
        # 20 beams of constant elevation for each scanner, 4 returns a beam; the lower half of the lasers is down_lidar's.
        columns = {name: [] for name in ["x", "y", "z", "intensity", "laser_number", "offset_ns"]}
        for name, first in [("down_lidar", 0), ("up_lidar", 32)]:
            for beam in range(20):
                for turn in range(4):
                    offset = 0.001 * (beam + 20 * turn)
                    elevation, azimuth, size = np.radians(-20 + 1.5 * beam), 1.6 * turn + 0.3 * beam, 10 + beam
                    point = size * np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
                    pose = body(0.1 * k + offset) @ ego_from[name]
                    world = pose[:3, :3] @ point + pose[:3, 3]
                    ego = inside(body(0.1 * k), world[None])[0].astype(np.float32)
                    truth.append([k, name == "up_lidar", *world, size])
                    for column, value in zip(columns, [*ego, 7, first + beam, int(round(offset * 1e9))]):
                        columns[column].append(value)
        kinds = [pa.float32(), pa.float32(), pa.float32(), pa.uint8(), pa.uint8(), pa.int32()]
        arrays = {name: pa.array(values, kind) for (name, values), kind in zip(columns.items(), kinds)}
        feather.write_feather(pa.table(arrays), f"{log}/sensors/lidar/{START_NS + k * STEP_NS}.feather", compression=["lz4", "zstd", "uncompressed"][k])
    np.savetxt(f"{log}/truth.txt", np.array(truth), fmt="%.9g")


def kitti360():
    imu_from_cam = matrix(R.from_euler("xyz", [1.55, 0.02, -1.6]), [1.57, 0.04, -0.28])
    velo_from_cam = matrix(R.from_euler("xyz", [-0.1, 1.5, -1.5]), [0.27, -0.1, -0.06])
    imu_from_velo = imu_from_cam @ np.linalg.inv(velo_from_cam)
    name = "2013_05_28_drive_0000_sync"
    write("kitti360/calibration/calib_cam_to_velo.txt", rows(velo_from_cam) + "\n")
    write("kitti360/calibration/calib_cam_to_pose.txt", f"image_00: {rows(imu_from_cam)}\nimage_01: {rows(np.eye(4))}\n")
    poses, stamps = "", ""
    for k in range(4):
        write(f"kitti360/data_3d_raw/{name}/velodyne_points/data/{k:010}.bin", kitti_bin(seen(0.1 * k, imu_from_velo)))
        stamps += f"2013-05-28 08:46:0{k}.{k}00000000\n"
        if k != 1:
            poses += f"{k} {rows(body(0.1 * k))}\n"
    write(f"kitti360/data_3d_raw/{name}/velodyne_points/timestamps.txt", stamps)
    write(f"kitti360/data_poses/{name}/poses.txt", poses)


def mulran():
    base_from_ouster = matrix(R.from_euler("xyz", np.radians([0.0001, 0.0003, 179.6654])), [1.7042, -0.021, 1.8047])
    poses = ""
    for k in range(-1, 5):
        poses += f"{START_NS + k * STEP_NS},{rows(body(0.1 * k)).replace(' ', ',')}\n"
    for k in range(4):
        write(f"mulran/sensor_data/Ouster/{START_NS + k * STEP_NS + (k == 3) * 10**10}.bin", kitti_bin(seen(0.1 * k, base_from_ouster)))
    write("mulran/global_pose.csv", poses)


def helipr():
    layouts = {
        "Ouster": lambda p, o, i: struct.pack("<ffffIHHH", *p, 5.0, int(round(o * 1e9)), 1, i, 2),
        "Velodyne": lambda p, o, i: struct.pack("<ffffHf", *p, 5.0, i, o),
        "Avia": lambda p, o, i: struct.pack("<fffBBBI", *p, 5, 0, i % 6, int(round(o * 1e9))),
        "Aeva": lambda p, o, i: struct.pack("<fffffiB", *p, 5.0, -1.0, int(round(o * 1e9)), 0),
    }
    for name, record in layouts.items():
        truth = ""
        for k in range(-1, 5):
            truth += tum(0, body(0.1 * k), time=str(START_NS + k * STEP_NS)) + "\n"
        write(f"helipr/LiDAR_GT/{name}_gt.txt", truth)
        for k in range(3):
            points = seen(0.1 * k, np.eye(4), OFFSETS)
            order = np.argsort(np.argsort(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))))
            write(f"helipr/LiDAR/{name}/{START_NS + k * STEP_NS}.bin", b"".join(record(p, o, i) for p, o, i in zip(points, OFFSETS, order)))


def nclt():
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    session, units = "2012-01-08", 0
    truth = "1599999999000000,nan,nan,nan,nan,nan,nan\n"
    for k in range(-1, 5):
        # world and body with z down, as NCLT has them
        pose = flip @ body(0.1 * k) @ flip
        yaw, pitch, roll = R.from_matrix(pose[:3, :3]).as_euler("ZYX")
        truth += f"{(START_NS + k * STEP_NS) // 1000}," + ",".join(repr(float(v)) for v in [*pose[:3, 3], roll, pitch, yaw]) + "\n"
    write(f"nclt/ground_truth/groundtruth_{session}.csv", truth)
    for k in range(4):
        points = inside(flip @ body(0.1 * k) @ flip, WORLD * [1, -1, -1])
        units = np.round((points + 100.0) / 0.005).astype(int)
        time = (START_NS + k * STEP_NS) // 1000 + (k == 3) * 10**7
        write(f"nclt/{session}/velodyne_sync/{time}.bin", b"".join(struct.pack("<HHHBB", *u, 9, i % 32) for i, u in enumerate(units)))


def newer_college():
    base_from_ouster = matrix(R.from_quat([0, 0, 0.924, 0.383]), [-0.084, -0.025, 0.050])
    truth = "#sec,nsec,x,y,z,qx,qy,qz,qw\n"
    for k in range(-1, 5):
        time = START_NS + k * STEP_NS
        pose = body(0.1 * k)
        truth += ",".join([str(time // 10**9), str(time % 10**9)] + [repr(float(v)) for v in [*pose[:3, 3], *quaternion(pose)]]) + "\n"
    write("newer_college/ground_truth/registered_poses.csv", truth)
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity t reflectivity ring noise range\nSIZE 4 4 4 4 4 2 1 2 4\nTYPE F F F F U U U U U\nCOUNT 1 1 1 1 1 1 1 1 1\n"
    for k in range(3):
        points, time = seen(0.1 * k, base_from_ouster, OFFSETS), START_NS + k * STEP_NS
        order = np.argsort(np.argsort(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))))
        body_bytes = b"".join(struct.pack("<ffffIHBHI", *p, 5.0, int(round(o * 1e9)), 1, i, 2, int(np.linalg.norm(p) * 1000)) for p, o, i in zip(points, OFFSETS, order))
        text = head + f"WIDTH {N}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {N}\nDATA binary\n"
        write(f"newer_college/raw_format/ouster_scan/cloud_{time // 10**9}_{time % 10**9:09}.pcd", text.encode() + body_bytes)


def semantic_kitti():
    """Poses of the camera in the sequence's own folder; labels beside the scans; calib.txt as of KITTI odometry."""
    camera_from_velodyne = matrix(R.from_euler("zyx", [1.55, -1.56, 0.02]), [-0.01, -0.06, -0.29])
    body_from_sensor = matrix(R.from_euler("z", 0.02), [0.3, 0.0, 1.7])
    folder = "semantic_kitti/dataset/sequences/08"
    projection = "718.0 0.0 607.0 0.0 0.0 718.0 185.0 0.0 0.0 0.0 1.0 0.0"
    write(f"{folder}/calib.txt", "".join(f"P{i}: {projection}\n" for i in range(4)) + f"Tr: {rows(camera_from_velodyne)}\n")
    poses = [body(0.1 * k) @ body_from_sensor for k in range(3)]
    write(f"{folder}/poses.txt", "".join(rows(camera_from_velodyne @ p @ np.linalg.inv(camera_from_velodyne)) + "\n" for p in poses))
    write(f"{folder}/times.txt", "".join(f"{0.1 * k:.6e}\n" for k in range(3)))
    for k in range(3):
        write(f"{folder}/velodyne/{k:06}.bin", kitti_bin(seen(0.1 * k, body_from_sensor)))
        write(f"{folder}/labels/{k:06}.label", np.full(N, 40 | 7 << 16, "<u4").tobytes())


MAKERS = [nuscenes, argoverse, kitti360, semantic_kitti, mulran, helipr, nclt, newer_college]


def tables():
    """A table with all that is read, and columns of other types between."""
    kinds = {
        "b": pa.array([True, None, False]),
        "x": pa.array([0.5, -2.0, np.nan], pa.float16()),
        "d": pa.array([b"ab", b"", None]),
        "n": pa.array([-3, None, 2**40], pa.int64()),
        "u": pa.array([250, 0, 255], pa.uint8()),
        "s": pa.array(["up", "", "größer"]),
        "l": pa.array(["a", "bc", "d"], pa.large_string()),
        "y": pa.array([1.5, None, 3.0], pa.float64()),
    }
    for name in ["lz4", "zstd", "uncompressed"]:
        feather.write_feather(pa.table(kinds), os.path.join(HERE, f"table_{name}.feather"), compression=name, chunksize=2)
    feather.write_feather(pa.table({"o": pa.array([[1], [2, 3]]), "x": pa.array([1.0, 2.0])}), os.path.join(HERE, "nested.feather"), compression="uncompressed")


if __name__ == "__main__":
    np.savetxt(os.path.join(HERE, "world.txt"), WORLD, fmt="%.9g")
    for make in MAKERS + [tables]:
        make()
