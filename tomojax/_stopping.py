"""Ctrl-C for loops: asked for by a command, heard between parts of the work."""

from threading import Event

# Of the process, as signals are: what computes knows no command.
asked = Event()


def stop_if_asked() -> None:
    """**Raises:** `KeyboardInterrupt` once Ctrl-C was heard; in any thread."""
    if asked.is_set():
        raise KeyboardInterrupt
