"""Writes the small recordings of this folder with PyPI's `rosbags` and `mcap`: a robot that drives along x at 1 m/s for a second.

Two LiDARs at 10 Hz, eight lasers each: /points (PointCloud2, `t` in ns after the stamp, ring 0 is the highest) and, in the ROS 2
recordings, /livox/lidar (CustomMsg). A point's x is the number of its message, so that tests can tell them apart.
"""

import pathlib
import shutil


import numpy as np
from mcap.writer import CompressionType, Writer as WriterM
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

OUT = pathlib.Path(__file__).parent
T0 = 1_600_000_000_000_000_000
EXTRA = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "livox_ros_driver2/msg/CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line",
    "livox_ros_driver2/msg/CustomMsg": "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points",
}


def store(kind):
    types = get_typestore(kind)
    for name, text in EXTRA.items():
        if name not in types.types:
            types.register(get_types_from_msg(text, name))
    return types


def messages(types, is_ros1):
    make = lambda kind, /, *args, **kw: types.types[kind](*args, **kw)
    V = lambda x, y, z: make("geometry_msgs/msg/Vector3", x, y, z)
    Q = lambda: make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)

    def header(t, frame):
        stamp = make("builtin_interfaces/msg/Time", sec=t // 10**9, nanosec=t % 10**9)
        seq = {"seq": 0} if is_ros1 else {}
        return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **seq)

    def tf(t, parent, child, xyz):
        transform = make("geometry_msgs/msg/Transform", translation=V(*xyz), rotation=Q())
        stamped = make("geometry_msgs/msg/TransformStamped", header=header(t, parent), child_frame_id=child, transform=transform)
        return "tf2_msgs/msg/TFMessage", make("tf2_msgs/msg/TFMessage", transforms=[stamped])

    def cloud(t, k):
        n = 80
        a = np.zeros(n, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("ring", "<u2"), ("_", "<u2")])
        i = np.arange(n)
        a["x"], a["y"], a["z"] = 5 + k, np.cos(i), np.linspace(1, -1, 8)[i % 8] * np.hypot(5 + k, np.cos(i))
        a["intensity"], a["ring"], a["t"] = i, i % 8, i * 1_250_000
        fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("t", 16, 6), ("ring", 20, 4)]
        fields = [make("sensor_msgs/msg/PointField", name=f, offset=o, datatype=d, count=1) for f, o, d in fields]
        data = np.frombuffer(a.tobytes(), np.uint8)
        return "sensor_msgs/msg/PointCloud2", make(
            "sensor_msgs/msg/PointCloud2", header=header(t, "lidar"), height=1, width=n, fields=fields,
            is_bigendian=False, point_step=24, row_step=24 * n, data=data, is_dense=True)

    def livox(t, k):
        point = lambda i: make("livox_ros_driver2/msg/CustomPoint", offset_time=i * 1_000_000, x=float(k), y=float(i), z=0.5,
                               reflectivity=i, tag=0, line=i % 4)
        return "livox_ros_driver2/msg/CustomMsg", make(
            "livox_ros_driver2/msg/CustomMsg", header=header(t, "livox"), timebase=t, point_num=96, lidar_id=0,
            rsvd=np.zeros(3, np.uint8), points=[point(i) for i in range(96)])

    def odometry(t, x):
        pose = make("geometry_msgs/msg/Pose", position=make("geometry_msgs/msg/Point", x, 0.0, 0.0), orientation=Q())
        zeros = np.zeros(36)
        return "nav_msgs/msg/Odometry", make(
            "nav_msgs/msg/Odometry", header=header(t, "odom"), child_frame_id="base",
            pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=zeros),
            twist=make("geometry_msgs/msg/TwistWithCovariance", twist=make("geometry_msgs/msg/Twist", linear=V(0.0, 0.0, 0.0), angular=V(0.0, 0.0, 0.0)), covariance=zeros))

    def imu(t):
        return "sensor_msgs/msg/Imu", make(
            "sensor_msgs/msg/Imu", header=header(t, "imu"), orientation=Q(), orientation_covariance=np.full(9, -1.0),
            angular_velocity=V(0.1, 0.0, 0.0), angular_velocity_covariance=np.zeros(9),
            linear_acceleration=V(0.0, 0.0, 1.0), linear_acceleration_covariance=np.zeros(9))

    def fix(t):
        status = make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
        return "sensor_msgs/msg/NavSatFix", make(
            "sensor_msgs/msg/NavSatFix", header=header(t, "gps"), status=status, latitude=50.5, longitude=10.25, altitude=300.0,
            position_covariance=np.zeros(9), position_covariance_type=0)

    def image(t):
        return "sensor_msgs/msg/Image", make(
            "sensor_msgs/msg/Image", header=header(t, "camera"), height=6, width=8, encoding="bgr8", is_bigendian=0, step=24,
            data=np.arange(144, dtype=np.uint8))

    def info(t):
        k = np.array([100.0, 0, 3.5, 0, 100.0, 2.5, 0, 0, 1])
        roi = make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        small = dict(d=np.zeros(5), k=k, r=np.eye(3).ravel(), p=np.zeros(12))
        small = {n.upper(): v for n, v in small.items()} if is_ros1 else small
        return "sensor_msgs/msg/CameraInfo", make(
            "sensor_msgs/msg/CameraInfo", header=header(t, "camera"), height=6, width=8, distortion_model="plumb_bob",
            binning_x=0, binning_y=0, roi=roi, **small)

    for child, xyz in [("lidar", (0.5, 0.0, 2.0)), ("livox", (1.0, 0.0, 1.0)), ("imu", (0.0, 0.0, 0.0)), ("camera", (0.0, 0.0, 1.5))]:
        yield "/tf_static", T0, tf(T0, "base", child, xyz)
    for i in range(24):
        t, x = T0 + i * 50_000_000, i * 0.05
        yield "/tf", t, tf(t, "odom", "base", (x, 0.0, 0.0))
        yield "/odom", t, odometry(t, 2 * x)
        yield "/imu", t, imu(t)
        if i % 2 == 0 and i < 20:
            # Recorded when the sweep is over.
            yield "/points", t + 100_000_000, cloud(t, i // 2)
            if not is_ros1:
                yield "/livox/lidar", t + 100_000_000, livox(t, i // 2)
        if i % 8 == 0:
            yield "/fix", t, fix(t)
            yield "/camera/image_raw", t, image(t)
            yield "/camera/camera_info", t, info(t)


def write(writer, types, is_ros1):
    channels = {}
    with writer:
        for topic, t, (kind, message) in messages(types, is_ros1):
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=types)
            data = types.serialize_ros1(message, kind) if is_ros1 else types.serialize_cdr(message, kind)
            writer.write(channels[topic], t, data)


def ros1(name, compression):
    path = OUT / name
    path.unlink(missing_ok=True)
    writer = Writer1(path)
    writer.chunk_threshold = 8192
    if compression:
        writer.set_compression(compression)
    write(writer, store(Stores.ROS1_NOETIC), True)


def ros2(name, plugin, mode=None):
    path = OUT / name
    shutil.rmtree(path, ignore_errors=True)
    writer = Writer2(path, version=9, storage_plugin=plugin)
    if mode:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    write(writer, store(Stores.ROS2_HUMBLE), False)


def mcap(name, compression, **options):
    types = store(Stores.ROS2_HUMBLE)
    with open(OUT / name, "wb") as file:
        writer, channels = WriterM(file, compression=compression, chunk_size=8192, **options), {}
        writer.start(profile="ros2")
        for topic, t, (kind, message) in messages(types, False):
            if topic not in channels:
                text, _ = types.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
                channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
            writer.add_message(channels[topic], log_time=t, publish_time=t, data=bytes(types.serialize_cdr(message, kind)))
        writer.finish()


ros1("ros1_lz4.bag", Writer1.CompressionFormat.LZ4)
ros1("ros1_bz2.bag", Writer1.CompressionFormat.BZ2)
ros2("ros2_file", StoragePlugin.SQLITE3, CompressionMode.FILE)
ros2("ros2_message", StoragePlugin.MCAP, CompressionMode.MESSAGE)
mcap("zstd.mcap", CompressionType.ZSTD)
mcap("lz4.mcap", CompressionType.LZ4)
