"""Files and messages of tsdfuse, read by programs that know nothing of it.

    readers.py octomap FILE.bt VOXELS.npz
    readers.py nav2 FILE.yaml VOXELS.npz LOW HIGH
    readers.py geotiff FILE.tif LAYERS.npz EPSG
    readers.py mcap FILE.mcap
    readers.py foxglove ws://ADDRESS TRIANGLES TOPIC...

Each ends with an error where something is not as it must be, and else prints what it found as JSON. Needs numpy, and of PyPI
mcap-ros2-support, pillow, pyoctomap, pyyaml, rasterio, rosbags and websockets.
"""

import asyncio
import json
import struct
import sys
from collections import Counter
from pathlib import Path

import numpy as np


def octomap(file, voxels):
    """OctoMap's own library, voxel by voxel."""
    import pyoctomap

    tree = pyoctomap.OcTree(1.0)
    assert tree.readBinary(file)
    known = np.load(voxels)
    edge = float(known["voxel_size_m"])
    assert abs(tree.getResolution() - edge) < 1e-9, tree.getResolution()
    for voxel, occupied in zip(known["voxels"], known["occupied"]):
        node = tree.search(((voxel + 0.5) * edge).tolist())
        assert node is not None, voxel
        assert tree.isNodeOccupied(node) == bool(occupied), voxel
    # Nothing else is known.
    volume = sum(leaf.getSize() ** 3 for leaf in tree.begin_leafs())
    assert abs(volume / edge**3 - len(known["voxels"])) < 0.5, volume
    return {"voxels": len(known["voxels"]), "nodes": tree.size()}


def nav2(file, voxels, low, high):
    """The picture with Pillow, its place with PyYAML; by the columns of voxels between two heights."""
    import yaml
    from PIL import Image

    place = yaml.safe_load(Path(file).read_text())
    picture = np.flipud(np.asarray(Image.open(Path(file).parent / place["image"])))
    assert place["mode"] == "raw" and place["negate"] == 0
    known = np.load(voxels)
    edge = float(known["voxel_size_m"])
    assert place["resolution"] == edge
    height = (known["voxels"][:, 2] + 0.5) * edge
    within = (float(low) <= height) & (height <= float(high))
    cells = known["voxels"][within][:, :2]
    first = cells.min(axis=0)
    assert np.allclose(place["origin"], [*(first * edge), 0])
    expected = np.full(picture.shape, 255)
    for occupied in (0, 1):
        own = cells[known["occupied"][within] == occupied] - first
        expected[own[:, 1], own[:, 0]] = 100 * occupied
    assert np.array_equal(picture, expected)
    return {value: int((picture == value).sum()) for value in (0, 100, 255)}


def geotiff(file, layers, epsg):
    """GDAL, band by band."""
    import rasterio

    with rasterio.open(file) as raster, np.load(layers) as expected:
        assert raster.crs.to_epsg() == int(epsg), raster.crs
        assert np.isnan(raster.nodata)
        cell = float(expected["cell_m"])
        left, bottom = expected["low_m"]
        assert np.allclose(raster.transform[:6], [cell, 0, left, 0, -cell, bottom + raster.height * cell])
        for number, name in enumerate(raster.descriptions, 1):
            assert np.array_equal(raster.read(number), expected[name], equal_nan=True), name
        return {"bands": raster.descriptions, "known": int(np.isfinite(raster.read(1)).sum())}


def check(kind, message):
    """What must hold of any message of a kind; how much is in it."""
    if kind.endswith("PointCloud2"):
        assert len(message.data) == message.row_step == message.width * message.point_step
        fields = {field.name: field.offset for field in message.fields}
        rows = np.frombuffer(bytes(message.data), np.uint8).reshape(-1, message.point_step)
        points = np.stack([rows[:, fields[axis]:][:, :4].copy().view("<f4")[:, 0] for axis in "xyz"], 1)
        assert np.isfinite(points).all()
        return len(points)
    if kind.endswith("OccupancyGrid"):
        assert len(message.data) == message.info.width * message.info.height
        assert set(np.unique(np.asarray(message.data))) <= {-1, *range(101)}
        return len(message.data)
    if kind.endswith("MarkerArray"):
        for marker in message.markers:
            assert marker.type == 11 and len(marker.points) % 3 == 0
            assert (marker.action == 2) == (len(marker.points) == 0)
    return 1


def triangles(surface, message):
    """Keeps a surface up to date with markers."""
    for marker in message.markers:
        surface.pop((marker.ns, marker.id), None)
        if marker.action == 0:
            surface[marker.ns, marker.id] = len(marker.points) // 3
    return sum(surface.values())


def mcap(file):
    """The MCAP library with its ROS 2 decoder, and rosbags with its own."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.highlevel import AnyReader

    found, surface, count = {}, {}, 0
    with open(file, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(check(schema.name, message))
            if channel.topic == "/surface":
                count = triangles(surface, message)
    also, other = Counter(), {}
    with AnyReader([Path(file)]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            assert check(connection.msgtype, message) == found[connection.topic][also[connection.topic]]
            also[connection.topic] += 1
            if connection.topic == "/surface":
                triangles(other, message)
    assert other == surface and dict(also) == {topic: len(values) for topic, values in found.items()}
    return {"messages": dict(also), "triangles": count}


async def listen(url, expected, topics):
    """A client of Foxglove's protocol: subscribes to all, until the surface is whole and these topics were heard."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    from websockets.asyncio.client import connect

    store = get_typestore(Stores.EMPTY)
    channels, heard, surface = {}, Counter(), {}
    async with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        while sum(surface.values()) != expected or not topics <= set(heard):
            data = await asyncio.wait_for(socket.recv(), 100)
            if isinstance(data, str):
                told = json.loads(data)
                if told["op"] == "advertise":
                    asked = []
                    for channel in told["channels"]:
                        assert channel["encoding"] == "cdr" and channel["schemaEncoding"] == "ros2msg"
                        types = get_types_from_msg(channel["schema"], channel["schemaName"])
                        store.register({name: kind for name, kind in types.items() if name not in store.types})
                        channels[channel["id"]] = channel
                        asked.append({"id": channel["id"], "channelId": channel["id"]})
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
            elif data[0] == 1:
                identity, _ = struct.unpack_from("<IQ", data, 1)
                kind = channels[identity]["schemaName"]
                message = store.deserialize_cdr(data[13:], kind)
                check(kind, message)
                topic = channels[identity]["topic"]
                heard[topic] += 1
                if topic == "/surface":
                    triangles(surface, message)
    return dict(heard)


def foxglove(url, expected, *topics):
    """A client made of a WebSocket library, JSON and rosbags."""
    return asyncio.run(listen(url, int(expected), set(topics)))


if __name__ == "__main__":
    modes = {run.__name__: run for run in (octomap, nav2, geotiff, mcap, foxglove)}
    print(json.dumps(modes[sys.argv[1]](*sys.argv[2:])))
