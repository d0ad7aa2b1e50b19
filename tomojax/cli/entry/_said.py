"""Stages of long work, on standard error."""

import sys
from collections.abc import Callable
from time import monotonic

# Off a terminal, seconds between lines: a command that ends at once says one line.
_NEWS = 4.0


def stages() -> Callable[[str], None]:
    """Returns what says each stage: in a line that changes, or now and then a line.

    An empty text clears the line.
    """
    last = monotonic()

    def say(text: str) -> None:
        nonlocal last
        if sys.stderr.isatty():
            end = "" if text else "\r"
            print(f"\r\033[K{text}", end=end, file=sys.stderr, flush=True)
        elif text and monotonic() - last > _NEWS:
            last = monotonic()
            print(f"{text} …", file=sys.stderr, flush=True)

    return say
