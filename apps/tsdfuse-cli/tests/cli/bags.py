"""Writes a plain folder as recordings with PyPI's `rosbags` and `mcap`, and compares the meshes of two logs.

    bags.py write FOLDER KIND OUT      KIND: ros1, ros1-lz4, ros1-bz2, db3, db3-zstd, mcap, mcap-zstd, plain-mcap-lz4, plain-mcap-zstd (MCAP's own library)
    bags.py compare A.ply B.ply        vertices of both, and the largest distance from one to the nearest of the other

At each time, tf knows one pose. PandaSet's sweeps overlap by 3 ms, and the reader finds the motion of each by itself. So each sweep is written 4 ms later
after the one before than it was: tf then holds the motions of all.
"""

import json
import pathlib
import sys

import numpy as np
from scipy.spatial.transform import Rotation

COLUMNS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")]
LATER_NS = 4_000_000
KINDS = {"<f4": 7, "<u2": 4}


def between(times, poses, at):
    """The poses at some times: on SE(3) as a turn at a constant rate and a straight line, as from both neighbours."""
    times = np.asarray(times)
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    share = ((at - times[k]) / (times[k + 1] - times[k]))[:, None]
    turns, shifts = Rotation.from_matrix(poses[:, :, :3]), poses[:, :, 3]
    step = (turns[k].inv() * turns[k + 1]).as_rotvec()
    return turns[k] * Rotation.from_rotvec(share * step), shifts[k] + share * (shifts[k + 1] - shifts[k])


def sweeps(folder):
    """Time in ns, columns and poses over time of each sweep."""
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    stamps = [10**17 + k * 10**8 for k in range(len(poses))]
    if (folder / "times.txt").exists():
        split = [line.split(".") for line in (folder / "times.txt").read_text().split()]
        stamps = [int(s) * 10**9 + int(f.ljust(9, "0")) for s, f in split]
    motions = [None] * len(poses)
    if (folder / "motion.txt").exists():
        lines = (folder / "motion.txt").read_text().splitlines()
        motions = [np.array(line.split(), float) if line.strip() != "-" else None for line in lines]
    for k, (stamp, pose, motion) in enumerate(zip(stamps, poses, motions)):
        name = f"{k:06}"
        raw = np.fromfile(folder / f"velodyne/{name}.bin", "<f4").reshape(-1, 4)
        columns = {c: raw[:, i] for i, (c, _) in enumerate(COLUMNS)}
        for kind, end in (("times", "f32"), ("rings", "u16")):
            file = folder / kind / f"{name}.{end}"
            if file.exists():
                columns[kind[:-1]] = np.fromfile(file, "<f4" if end == "f32" else "<u2")
        stamp += k * LATER_NS
        tf = {stamp: pose}
        if motion is not None and "time" in columns:
            secs = columns["time"].astype(float)
            finite = np.isfinite(secs)
            # Two poses tell the motion, before and beyond them, too.
            order = np.argsort([0.0, motion[0]])
            own = np.array([0.0, motion[0]])[order], np.array([pose, motion[1:].reshape(3, 4)])[order]
            ends = [int(np.floor(secs[finite].min() * 1e9)), int(np.ceil(secs[finite].max() * 1e9))]
            turns, shifts = between(*own, np.array(ends) * 1e-9)
            tf |= {stamp + t: np.c_[R, p] for t, R, p in zip(ends, turns.as_matrix(), shifts)}
        yield stamp, columns, tf


def cloud(columns):
    kinds = [(name, values.dtype.str) for name, values in columns.items()]
    table = np.empty(len(columns["x"]), kinds)
    for name, values in columns.items():
        table[name] = values
    fields = [(name, table.dtype.fields[name][1], KINDS[kind]) for name, kind in kinds]
    return table, fields


def write_rosbags(folder, kind, out):
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if kind.startswith("ros1") else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in types.types:
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    make = lambda name, /, *args, **kw: types.types[name](*args, **kw)

    def header(t, frame):
        stamp = make("builtin_interfaces/msg/Time", sec=t // 10**9, nanosec=t % 10**9)
        return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if kind.startswith("ros1") else {}))

    def messages():
        for stamp, columns, tf in sweeps(folder):
            for t, pose in sorted(tf.items()):
                x = make("geometry_msgs/msg/Vector3", *pose[:, 3].tolist())
                q = make("geometry_msgs/msg/Quaternion", *Rotation.from_matrix(pose[:, :3]).as_quat().tolist())
                transform = make("geometry_msgs/msg/Transform", translation=x, rotation=q)
                stamped = make("geometry_msgs/msg/TransformStamped", header=header(t, "map"), child_frame_id="lidar", transform=transform)
                yield "/tf", "tf2_msgs/msg/TFMessage", t, make("tf2_msgs/msg/TFMessage", transforms=[stamped])
            table, fields = cloud(columns)
            fields = [make("sensor_msgs/msg/PointField", name=n, offset=o, datatype=d, count=1) for n, o, d in fields]
            yield "/points", "sensor_msgs/msg/PointCloud2", stamp, make(
                "sensor_msgs/msg/PointCloud2", header=header(stamp, "lidar"), height=1, width=len(table), fields=fields,
                is_bigendian=False, point_step=table.itemsize, row_step=table.nbytes, data=np.frombuffer(table.tobytes(), np.uint8),
                is_dense=True)

    if kind.startswith("ros1"):
        writer, serialize = Writer1(out), types.serialize_ros1
        if kind != "ros1":
            writer.set_compression(Writer1.CompressionFormat[kind.removeprefix("ros1-").upper()])
    else:
        plugin = StoragePlugin.MCAP if kind.startswith("mcap") else StoragePlugin.SQLITE3
        writer, serialize = Writer2(out, version=9, storage_plugin=plugin), types.serialize_cdr
        if kind.endswith("zstd"):
            mode = CompressionMode.STORAGE if kind.startswith("mcap") else CompressionMode.MESSAGE
            writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, name, t, message in messages():
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, name, typestore=types)
            writer.write(topics[topic], t, serialize(message, name))


def write_mcap(folder, compression, out):
    """With MCAP's own library, in compressed chunks."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    point_cloud2 = (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\n"
        "uint32 row_step\nuint8[] data\nbool is_dense\n"
        "================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        "================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        "================\nMSG: sensor_msgs/PointField\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n"
    )
    tf_message = (
        "geometry_msgs/TransformStamped[] transforms\n"
        "================\nMSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        "================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        "================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        "================\nMSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
        "================\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
        "================\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    )
    header = lambda t, frame: {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": frame}
    with open(out, "wb") as file, Writer(file, compression=CompressionType[compression.upper()]) as writer:
        clouds = writer.register_msgdef("sensor_msgs/msg/PointCloud2", point_cloud2)
        transforms = writer.register_msgdef("tf2_msgs/msg/TFMessage", tf_message)
        for stamp, columns, tf in sweeps(folder):
            for t, pose in sorted(tf.items()):
                q = Rotation.from_matrix(pose[:, :3]).as_quat()
                transform = {"translation": dict(zip("xyz", pose[:, 3].tolist())), "rotation": dict(zip("xyzw", q.tolist()))}
                message = {"transforms": [{"header": header(t, "map"), "child_frame_id": "lidar", "transform": transform}]}
                writer.write_message("/tf", transforms, message, log_time=t, publish_time=t)
            table, fields = cloud(columns)
            fields = [{"name": n, "offset": o, "datatype": d, "count": 1} for n, o, d in fields]
            message = {"header": header(stamp, "lidar"), "height": 1, "width": len(table), "fields": fields, "is_bigendian": False,
                       "point_step": table.itemsize, "row_step": table.nbytes, "data": table.tobytes(), "is_dense": True}
            writer.write_message("/points", clouds, message, log_time=stamp, publish_time=stamp)


def vertices(path):
    """Those of a binary PLY."""
    data = pathlib.Path(path).read_bytes()
    end = data.index(b"end_header\n") + 11
    sizes = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4", "ushort": "<u2", "short": "<i2"}
    kinds, count, of = [], 0, None
    for line in data[:end].decode().splitlines():
        word = line.split()
        if word[0] == "element":
            of = word[1]
            count = int(word[2]) if of == "vertex" else count
        elif word[0] == "property" and of == "vertex":
            kinds.append((word[2], sizes[word[1]]))
    table = np.frombuffer(data, kinds, count, end)
    return np.c_[table["x"], table["y"], table["z"]].astype(float)


def compare(a, b):
    from scipy.spatial import cKDTree

    a, b = vertices(a), vertices(b)
    there, back = cKDTree(b).query(a, workers=2)[0], cKDTree(a).query(b, workers=2)[0]
    told = {"vertices": [len(a), len(b)], "largest_m": float(max(there.max(), back.max())),
            "beyond_0.1_mm": int((there > 1e-4).sum() + (back > 1e-4).sum())}
    if len(a) == len(b):
        told["in_order_m"] = float(np.linalg.norm(a - b, axis=1).max())
    return told


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["write", folder, "plain-mcap-lz4" | "plain-mcap-zstd" as kind, out]:
            write_mcap(pathlib.Path(folder), kind.removeprefix("plain-mcap-"), out)
        case ["write", folder, kind, out]:
            write_rosbags(pathlib.Path(folder), kind, pathlib.Path(out))
        case ["compare", a, b]:
            print(json.dumps(compare(a, b)))
        case _:
            sys.exit(__doc__)
