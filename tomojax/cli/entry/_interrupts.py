"""Ctrl-C: heard within two seconds, whatever the command is doing.

Python runs a signal's handler in the main thread, after that thread's current call ends. A
compiler's call takes up to a minute. A separate thread therefore hears Ctrl-C as well. That
thread ends the process if the command has not ended by itself. Files survive such an end at
any moment.
"""

import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from time import monotonic, sleep
from typing import Any, NoReturn

from tomojax._stopping import asked
from tomojax._whole import remove_unfinished

# Seconds that a command has to end by itself. On a machine with much other work the end
# takes longer than this: two seconds are promised.
_PATIENCE = 1.0

# Exit status after Ctrl-C, as of shells.
STOPPED = 130

# Set while a command ends by itself however long that takes (a recorder's last slots), and
# while a thread listens.
_own_end, _listens = Event(), Event()


@contextmanager
def listening(words: Callable[[], str]) -> Iterator[None]:
    """Hears Ctrl-C; the line that `words` returns is printed before the process ends."""
    # Ctrl-C may be ignored, as a shell asks of what runs in the background: then nothing is
    # heard, unless a command listens to it (`interrupts`).
    if signal.getsignal(signal.SIGINT) not in (
        signal.default_int_handler,
        signal.SIG_IGN,
    ):
        yield  # whoever called this decides
        return
    ear, mouth = socket.socketpair()
    mouth.setblocking(False)
    before = signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
    Thread(target=_hear, args=(ear, words), daemon=True).start()
    _listens.set()
    told, sys.unraisablehook = sys.unraisablehook, _untold(sys.unraisablehook)
    try:
        yield
    finally:
        sys.unraisablehook = told
        _listens.clear()
        signal.set_wakeup_fd(before)
        mouth.close()


def _untold(tell: Callable[[Any], Any]) -> Callable[[Any], None]:
    """Leaves out a Ctrl-C that came in a clean-up: the listener ends the process."""

    def said(raised: Any) -> None:
        if not issubclass(raised.exc_type, KeyboardInterrupt):
            tell(raised)

    return said


def _hear(ear: socket.socket, words: Callable[[], str]) -> None:
    due = None  # when the process ends at the latest
    with ear, suppress(OSError):
        while True:
            if due is not None:
                ear.settimeout(max(1e-3, due - monotonic()))
            try:
                numbers = ear.recv(64)
            except TimeoutError:
                _end(words)
            if not numbers:  # the command has ended; what its threads compile has not
                if due is not None:
                    sleep(max(0.0, due - monotonic()))
                    os._exit(STOPPED)
                return
            times = numbers.count(signal.SIGINT)
            if not times or _own_end.is_set():
                continue
            if times > 1 or due is not None:
                _end(words)
            due = monotonic() + _PATIENCE


def _end(words: Callable[[], str]) -> NoReturn:
    remove_unfinished()
    with suppress(Exception):
        print(f"\n{words()}", file=sys.stderr, flush=True)
    os._exit(STOPPED)


@contextmanager
def interrupts(own_end: bool = False) -> Iterator[Event]:
    """Turns Ctrl-C into an event, since an exception inside a callback may be lost.

    A second Ctrl-C ends the process at once; written files lose nothing. If `own_end` is
    true, the command may take its time after the first Ctrl-C.
    """

    def handle(number: int, frame: Any) -> None:
        # Where a thread listens, it has a word to say first.
        if asked.is_set() and (own_end or not _listens.is_set()):
            os._exit(STOPPED)
        asked.set()

    if own_end:
        _own_end.set()
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)
        asked.clear()
        _own_end.clear()
