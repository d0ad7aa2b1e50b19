"""Stages of long work, on standard error."""

import sys
from collections.abc import Callable


def stages() -> Callable[[str], None]:
    """Returns what says each stage: in a line that changes, or a line each off a terminal.

    An empty text clears the line.
    """

    def say(text: str) -> None:
        if sys.stderr.isatty():
            end = "" if text else "\r"
            print(f"\r\033[K{text}", end=end, file=sys.stderr, flush=True)
        elif text:
            print(f"{text} …", file=sys.stderr, flush=True)

    return say
