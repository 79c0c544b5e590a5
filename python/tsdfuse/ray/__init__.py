"""Maps too large for one machine, on a cluster of `Ray <https://docs.ray.io>`_ (``pip install tsdfuse[ray]``).

    import tsdfuse.ray

    report = tsdfuse.ray.fuse(["monday.mcap", "tuesday.mcap"], "city/tileset.json", span=200, memory_per_task="2G")

Maps travel as files in a folder that all nodes share; only names, sizes and checksums pass through Ray. The result is, bit for bit, that
of one machine. ``docs/cluster.md`` explains how.
"""

from ._fuse import fuse

__all__ = ["fuse"]
