"""Ctrl-C for loops: a command asks for the stop, a loop stops between parts of its work."""

from threading import Event

# Of the process, as signals are: what computes knows no command.
asked = Event()


def stop_if_asked() -> None:
    """Stops any thread once Ctrl-C was heard. **Raises:** `KeyboardInterrupt`."""
    if asked.is_set():
        raise KeyboardInterrupt
