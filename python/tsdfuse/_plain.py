"""Plain data for the engine, of what Python people have at hand."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any


def plain(value: Any) -> Any:
    """The value as dictionaries, lists, numbers and text."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):  # NumPy's arrays and numbers
        return value.tolist()
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    raise TypeError(f"{type(value).__name__} is no plain data")
