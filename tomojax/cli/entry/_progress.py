"""Progress of long work, on standard error."""

import sys
from time import monotonic
from typing import Any

from tomojax._stopping import stop_if_asked

# Seconds between two states of a line that changes; and, off a terminal, between lines: a
# command that ends at once says one line.
_EVERY = 0.1
_NEWS = 4.0


class Progress:
    """Says what goes on: in a line that changes, or off a terminal now and then in a line.

    The line goes at the end of the context. Work calls the object with the parts that are
    done and the number of all, and stops there after Ctrl-C.
    """

    def __init__(self, label: str = "", unit: str = ""):
        self.label, self._unit = label, unit
        self._began = self._last = monotonic()
        self._shown = False

    def __call__(self, done: int, total: int) -> None:
        self.say(f"{done} of {total} {self._unit}".rstrip(), _EVERY if done < total else 0)
        stop_if_asked()

    def say(self, text: str, every: float = 0.0) -> None:
        """Replaces the line; on a terminal not before `every` s have gone by."""
        now, terminal = monotonic(), sys.stderr.isatty()
        if not text or now - self._last < (every if terminal else _NEWS):
            return
        self._last = now
        words = f"{self.label} {text}".strip()
        told = f"{words}; {now - self._began:.0f} s so far"
        if terminal:
            print(f"\r\033[K{told}", end="", file=sys.stderr, flush=True)
            self._shown = True
        else:
            print(told, file=sys.stderr, flush=True)

    def above(self, text: str) -> None:
        """Says something that stays."""
        self._clear()
        print(text, file=sys.stderr, flush=True)

    def _clear(self) -> None:
        if self._shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
        self._shown = False

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: Any) -> None:
        self._clear()
