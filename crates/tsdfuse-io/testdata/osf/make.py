"""Writes posed.osf with PyPI's `ouster-sdk` (1.0.1): two sensors on a vehicle that drives and turns, in front of the wall x = 20 m.

The metadata hold where each sensor sits, the columns where the vehicle was.
"""

import sys

import numpy as np
from ouster.sdk import core, osf

ROWS, COLUMNS = 8, 128


def info(serial, sensor_to_body):
    """A sensor with 8 beams."""
    told = core.SensorInfo.from_default(core.LidarMode._512x10)
    told.sn = serial
    told.beam_altitude_angles, told.beam_azimuth_angles = np.linspace(10, -10, ROWS), np.array([0.0, 0.7] * 4)
    told.format.columns_per_frame, told.format.column_window = COLUMNS, (0, COLUMNS - 1)
    told.format.pixels_per_column, told.format.pixel_shift_by_row = ROWS, [0, 1] * 4
    told.sensor_to_body = sensor_to_body
    return told


def turned(yaw, x, y, z):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


infos = [info(1, turned(0.0, 0.5, 0.0, 1.8)), info(2, turned(0.6, -0.4, 0.7, 1.2))]
writer = osf.Writer(sys.argv[1], infos)
for k in range(2):
    for sensor, told in enumerate(infos):
        scan = core.LidarFrame(told, [core.FieldType(core.ChanField.RANGE, np.uint32)])
        at = k + (np.arange(COLUMNS) + 100 * sensor) / COLUMNS
        scan.timestamp[:] = (10**18 + at * 10**8).astype(np.uint64)
        scan.measurement_id[:] = np.arange(COLUMNS)
        scan.status[:] = 1
        scan.pose[:] = [turned(0.1 * t, 2.0 * t, 0.3 * t, 0.0) for t in at]
        lut = core.XYZLut(told, use_extrinsics=True)
        # Points at 1 and 2 m span the rays.
        one, two = [lut(np.full((ROWS, COLUMNS), mm, np.uint32)) for mm in (1000, 2000)]
        world = [np.einsum("cij,rcj->rci", scan.pose[:, :3, :3], p) + scan.pose[:, :3, 3] for p in (one, two)]
        step = (world[1] - world[0])[:, :, 0]
        mm = 1000 + (20.0 - world[0][:, :, 0]) / np.where(np.abs(step) > 0.2, step, np.nan) * 1000
        scan.field("RANGE")[:] = np.where((mm > 500) & (mm < 60_000), mm, 0).round().astype(np.uint32)
        scan.frame_id = k
        writer.save(sensor, scan)
writer.close()
