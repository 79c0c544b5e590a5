"""The command ``tsdfuse``, as ``python -m tsdfuse``."""

from __future__ import annotations

import signal
import sys

from . import _core
from ._run import command_start


def main() -> int:
    # The command stops by itself, between two scans.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    return _core.command(command_start(), ["tsdfuse", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
