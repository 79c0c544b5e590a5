"""A folder that all nodes share: a local or mounted one, or a URL of fsspec (``s3://bucket/city``, ``gs://``, ``file://``).

A file appears when it is complete, under a name that says what it is. The same work gives the same bytes, so it may be done twice.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .._core import checksum
from ..errors import StoreError


#: Where a file is there at once and whole when it was uploaded, and moving it is another copy.
OBJECT_STORES = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "oci"}


class Folder:
    """A shared folder. It can be pickled."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self.local = None if "://" in url else Path(url).absolute()

    def __repr__(self) -> str:
        return f"Folder({self.url!r})"

    def __truediv__(self, name: str) -> Folder:
        return Folder(f"{self.url}/{name}")

    def _remote(self, name: str) -> tuple[Any, str]:
        import fsspec

        return fsspec.core.url_to_fs(f"{self.url}/{name}")  # type: ignore[no-any-return]

    @contextlib.contextmanager
    def reading(self, name: str, expected: str | None = None) -> Iterator[Path]:
        """A file as a local one, checked."""
        with contextlib.ExitStack() as stack:
            if self.local is not None:
                path = self.local / name
            else:
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="tsdfuse-"))
                path = Path(folder) / name.rsplit("/", 1)[-1]
                system, remote = self._remote(name)
                system.get_file(remote, str(path))
            if expected is not None and checksum(path) != expected:
                raise StoreError(f"{self.url}/{name}: is not the file that was written")
            yield path

    def put(self, path: Path, name: str, known: str | None = None) -> dict[str, Any]:
        """Moves a local file here; its name, size and checksum, if that is not known already."""
        told = {"name": name, "bytes": path.stat().st_size, "checksum": known or checksum(path)}
        if self.local is not None:
            target = self.local / name
            target.parent.mkdir(parents=True, exist_ok=True)
            beside = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
            shutil.move(path, beside)
            os.replace(beside, target)
        else:
            system, remote = self._remote(name)
            if self.url.split("://", 1)[0] in OBJECT_STORES:
                system.put_file(str(path), remote)
                return told
            system.makedirs(remote.rsplit("/", 1)[0], exist_ok=True)
            aside = f"{remote}.{uuid.uuid4().hex}"
            system.put_file(str(path), aside)
            system.mv(aside, remote)
        return told

    def put_all(self, folder: Path, name: str) -> int:
        """Moves all files of a local folder here; how many bytes they are."""
        total = 0
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            total += self.put(path, f"{name}/{path.relative_to(folder).as_posix()}")["bytes"]
        return total

    def write(self, name: str, data: Any) -> None:
        """Writes plain data as JSON."""
        with tempfile.TemporaryDirectory(prefix="tsdfuse-", dir=self._beside()) as folder:
            path = Path(folder) / "data.json"
            path.write_text(json.dumps(data, indent=1) + "\n")
            self.put(path, name)

    def read(self, name: str) -> Any:
        """Plain data, or ``None`` if there is no such file."""
        try:
            with self.reading(name) as path:
                return json.loads(path.read_text())
        except FileNotFoundError:
            return None

    def names(self, name: str) -> set[str]:
        """The names of what lies in a folder."""
        if self.local is not None:
            folder = self.local / name
            return set(os.listdir(folder)) if folder.is_dir() else set()
        system, remote = self._remote(name)
        system.invalidate_cache()  # others have written meanwhile
        try:
            return {found.rstrip("/").rsplit("/", 1)[-1] for found in system.ls(remote, detail=False)}
        except FileNotFoundError:
            return set()

    def _beside(self) -> str | None:
        """Where temporary files can be moved from without copying them."""
        if self.local is None:
            return None
        self.local.mkdir(parents=True, exist_ok=True)
        return str(self.local)

    @contextlib.contextmanager
    def working(self) -> Iterator[Path]:
        """A temporary folder, from which files are put here."""
        with tempfile.TemporaryDirectory(prefix=".tsdfuse-", dir=self._beside()) as folder:
            yield Path(folder)


def fetched(url: str) -> str:
    """A log as a local path: the same, or downloaded once for this process."""
    if "://" not in url or url.startswith("udp://"):
        return url
    import fsspec

    folder = Path(tempfile.gettempdir()) / f"tsdfuse-logs-{os.getpid()}"
    path = folder / hashlib.blake2b(url.encode(), digest_size=8).hexdigest() / url.rstrip("/").rsplit("/", 1)[-1]
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        system, remote = fsspec.core.url_to_fs(url)
        system.get(remote, str(path), recursive=system.isdir(remote))
    return str(path)
