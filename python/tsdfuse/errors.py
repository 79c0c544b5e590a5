"""What can go wrong, beside the exceptions of Python itself (``FileNotFoundError``, ``TypeError``, ...).

Every message is one sentence that names the file, the scan or the option.
"""

from __future__ import annotations


class Error(Exception):
    """Any error of the engine."""


class ConfigError(Error, ValueError):
    """An option or an argument has an impossible value."""


class FormatError(Error, ValueError):
    """A file is not in its format, or a folder holds no log."""


class BadScanError(Error, ValueError):
    """A scan cannot be fused. The map is as it was before."""


class EmptyResultError(Error, RuntimeError):
    """There is no result: no scan could be fused, or the map has no surface."""


class FullError(Error, MemoryError):
    """The memory, or that of the device, is full."""


class StoreError(Error, OSError):
    """A store cannot be read or written, or is damaged."""


class DeviceError(Error, RuntimeError):
    """There is no such GPU, or it failed."""
