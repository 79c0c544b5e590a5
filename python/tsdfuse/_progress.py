"""Progress while long work goes on: a callback, or a bar."""

from __future__ import annotations

import html
import sys
import time
from typing import Any, Callable, Optional, Union

Callback = Callable[[int, Optional[int], str], None]
"""Called with what is done, how much there is (``None`` where nobody knows), and what goes on."""

Progress = Union[bool, Callback, None]
"""``None``: a bar in notebooks. ``True``, ``False``: a bar, or none. Or a callback."""


def in_notebook() -> bool:
    """Whether pictures can be shown where this runs."""
    if "IPython" not in sys.modules:
        return False
    from IPython.core.getipython import get_ipython

    shell = get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"


def callback(progress: Progress, doing: str) -> Callback | None:
    """What is called meanwhile, if anything."""
    if callable(progress):
        return progress
    if progress is None:
        return NotebookBar(doing) if in_notebook() else None
    if not progress:
        return None
    return NotebookBar(doing) if in_notebook() else TerminalBar(doing)


class Bar:
    """What bars share: they are drawn at most ten times a second, and at the end."""

    def __init__(self, doing: str) -> None:
        self.doing = doing
        self.begun = time.monotonic()
        self.drawn = 0.0

    def __call__(self, done: int, total: int | None, what: str) -> None:
        now = time.monotonic()
        if now - self.drawn >= 0.1 or done == total:
            self.drawn = now
            self.draw(done, total, what)

    def text(self, done: int, total: int | None) -> str:
        rate = done / max(time.monotonic() - self.begun, 1e-9)
        return f"{self.doing} {done}{'' if total is None else f'/{total}'}, {rate:.1f}/s"

    def draw(self, done: int, total: int | None, what: str) -> None:
        raise NotImplementedError


class TerminalBar(Bar):
    """A line on standard error."""

    def draw(self, done: int, total: int | None, what: str) -> None:
        end = "\n" if done == total else ""
        sys.stderr.write(f"\r\x1b[K{self.text(done, total)} {what}"[:120] + end)
        sys.stderr.flush()


class NotebookBar(Bar):
    """A bar below the cell."""

    handle: Any = None

    def draw(self, done: int, total: int | None, what: str) -> None:
        from IPython.display import HTML, display

        bar = "" if total is None else f'<progress value="{done}" max="{total}"></progress> '
        shown = HTML(f"{bar}{html.escape(self.text(done, total))} {html.escape(what)}")  # type: ignore[no-untyped-call]
        if self.handle is None:
            self.handle = display(shown, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self.handle.update(shown)
