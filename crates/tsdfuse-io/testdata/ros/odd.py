"""Writes small MCAP files with PyPI's `rosbags` and `mcap` of what is unusual: other layouts of points, partial clouds, clocks, frames."""

import pathlib

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

OUT = pathlib.Path(__file__).parent
T0 = 1_600_000_000_000_000_000
TYPES = get_typestore(Stores.ROS2_HUMBLE)
TYPES.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


def make(kind, /, *args, **kw):
    return TYPES.types[kind](*args, **kw)


def header(t, frame="lidar"):
    return make("std_msgs/msg/Header", stamp=make("builtin_interfaces/msg/Time", sec=t // 10**9, nanosec=t % 10**9), frame_id=frame)


def cloud(t, array, offsets, kinds, height=1, is_big=False, padding=0):
    codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    width = array.size // height
    step = array.dtype.itemsize
    fields = [make("sensor_msgs/msg/PointField", name=n, offset=offsets[n], datatype=codes[kinds[n]], count=1) for n in offsets]
    rows = array.reshape(height, width)
    data = b"".join(row.tobytes() + bytes(padding) for row in rows)
    return "sensor_msgs/msg/PointCloud2", make(
        "sensor_msgs/msg/PointCloud2", header=header(t), height=height, width=width, fields=fields, is_bigendian=is_big,
        point_step=step, row_step=step * width + padding, data=np.frombuffer(data, np.uint8), is_dense=False)


def tf(t, parent, child, x=0.0):
    rotation = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    transform = make("geometry_msgs/msg/Transform", translation=make("geometry_msgs/msg/Vector3", x, 0.0, 0.0), rotation=rotation)
    stamped = make("geometry_msgs/msg/TransformStamped", header=header(t, parent), child_frame_id=child, transform=transform)
    return "tf2_msgs/msg/TFMessage", make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def write(name, messages):
    """messages: (topic, time of recording, (kind, message))"""
    with open(OUT / f"odd_{name}.mcap", "wb") as file:
        writer, channels = Writer(file, compression=CompressionType.ZSTD), {}
        writer.start(profile="ros2")
        for topic, t, (kind, message) in messages:
            if topic not in channels:
                text, _ = TYPES.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
                channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
            writer.add_message(channels[topic], log_time=t, publish_time=t, data=bytes(TYPES.serialize_cdr(message, kind)))
        writer.finish()


def grid(k, order):
    """8 beams and 20 columns, row by row, the highest row first; x is 5 + k in column 0. Two points measure nothing."""
    kinds = {"x": "f8", "y": "f8", "z": "f8", "intensity": "u2"}
    array = np.zeros(160, dtype=[("gap", "V3")] + [(n, order + c) for n, c in kinds.items()] + [("end", "V5")])
    row, column = np.divmod(np.arange(160), 20)
    angle, elevation = 2 * np.pi * column / 20, np.radians(14 - 4 * row)
    size = 5.0 + k
    array["x"], array["y"], array["z"] = size * np.cos(angle), size * np.sin(angle), size * np.tan(elevation)
    array["intensity"] = np.arange(160)
    array["x"][3] = np.nan
    for name in "xyz":
        array[name][17] = 0.0
    return array, {n: array.dtype.fields[n][1] for n in kinds}, kinds


def simple(points):
    array = np.array([tuple(p) for p in points], dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    return array, {"x": 0, "y": 4, "z": 8}, {"x": "f4", "y": "f4", "z": "f4"}


def ring(x, begin=0.0, end=1.0, n=200):
    turn = np.linspace(begin, end, n, endpoint=False) * 2 * np.pi
    return np.column_stack([x * np.cos(turn), x * np.sin(turn), np.where(np.arange(n) % 2, 0.3, -0.3)])


# Organized, big-endian, f64, with gaps between fields and after rows.
for name, order in [("big", ">"), ("little", "<")]:
    write(name, [("/points", T0 + k * 10**8, cloud(T0 + k * 10**8, *grid(k, order), height=8, is_big=order == ">", padding=7)) for k in range(5)])

# A turn in four messages.
write("partial", [("/points", T0 + k * 25_000_000, cloud(T0 + k * 25_000_000, *simple(ring(10.0 + k // 4, k % 4 / 4, k % 4 / 4 + 0.25)))) for k in range(24)])

# Stamps that stand still: the time of recording counts.
write("unstamped", [("/points", T0 + k * 10**8, cloud(0, *simple(ring(10.0 + k)))) for k in range(5)])

# Stamps on another clock than the recorder's: the stamps count.
write("clock", [("/points", T0 + k * 10**8 + 5 * 10**9, cloud(T0 + k * 10**8, *simple(ring(10.0 + k)))) for k in range(5)])

# Frames that go round.
write("cyclic", [("/tf", T0, tf(T0, "a", "b")), ("/tf", T0, tf(T0, "b", "lidar")), ("/tf", T0, tf(T0, "lidar", "a"))]
      + [("/points", T0 + k * 10**8, cloud(T0 + k * 10**8, *simple(ring(10.0)))) for k in range(5)])

# The clock was set back after three sweeps: by an hour, and by one sweep.
stamps = [0, 1, 2, -36_000, -35_999, -36_000, -35_998]
write("back", [("/points", T0 + k * 10**8, cloud(T0 + stamp * 10**8, *simple(ring(10.0 + k)))) for k, stamp in enumerate(stamps)])

# One line in a plane.
scan = make(
    "sensor_msgs/msg/LaserScan", header=header(T0), angle_min=0.0, angle_max=1.0, angle_increment=0.1, time_increment=0.0, scan_time=0.1,
    range_min=0.1, range_max=9.0, ranges=np.ones(10, np.float32), intensities=np.zeros(0, np.float32))
write("laser", [("/scan", T0 + k, ("sensor_msgs/msg/LaserScan", scan)) for k in range(3)])
