"""Dense 3D reconstruction from LiDAR: scans and poses in, a surface out.

    import tsdfuse

    m = tsdfuse.Map(voxel_size=0.05)
    for scan in tsdfuse.open("pandaset/002"):
        m.fuse(scan)
    m.mesh().write("street.ply")

Lengths are metres, times of scans nanoseconds, poses ``world_from_sensor`` as rigid matrices (4, 4) in float64; the sensor's frame
is x forward, y left, z up. A signed distance is positive on the side that the sensor saw. The same input gives the same map, bit for
bit, on any number of threads, and the same as the command ``tsdfuse``.
"""

from . import errors
from ._core import (
    Changes,
    Config,
    Esdf,
    Fused,
    Log,
    Map,
    Mesh,
    Moving,
    Nearby,
    Occupancy,
    Odometry,
    Reach,
    Scan,
    Session,
    Simulation,
    Store,
    Trajectory,
    View,
    compare,
    compare_trajectories,
    ground,
    sensor,
    sensors,
    set_threads,
    threads,
)
from ._core import version as _version
from ._progress import Progress
from ._run import evaluate, fuse, job, odometry, open, resume, run, session, simulate
from .errors import (
    BadScanError,
    ConfigError,
    DeviceError,
    EmptyResultError,
    Error,
    FormatError,
    FullError,
    StoreError,
)

__version__: str = _version()

__all__ = [
    "BadScanError",
    "Changes",
    "Config",
    "ConfigError",
    "DeviceError",
    "EmptyResultError",
    "Error",
    "Esdf",
    "FormatError",
    "FullError",
    "Fused",
    "Log",
    "Map",
    "Mesh",
    "Moving",
    "Nearby",
    "Occupancy",
    "Odometry",
    "Progress",
    "Reach",
    "Scan",
    "Session",
    "Simulation",
    "Store",
    "StoreError",
    "Trajectory",
    "View",
    "compare",
    "compare_trajectories",
    "errors",
    "evaluate",
    "fuse",
    "ground",
    "job",
    "odometry",
    "open",
    "resume",
    "run",
    "sensor",
    "sensors",
    "session",
    "set_threads",
    "simulate",
    "threads",
]
