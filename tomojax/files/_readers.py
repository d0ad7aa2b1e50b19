"""Keeps the process that opens files; a command may begin it before all else."""

import atexit
import json
import os
import socket
import subprocess
import sys
import threading
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.connection import Connection


class Readers:
    """The process that forks for each file; begun with the first file."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._control: socket.socket | None = None
        self._process: subprocess.Popen | None = None
        self._owner = 0

    def begin(self) -> bool:
        """Begins the process, which takes a moment to import what it needs."""
        # Others have no such sockets (macOS), no limit of memory, or no fork (Windows).
        if sys.platform != "linux" or not hasattr(os, "fork") or not sys.executable:
            return False
        with self._lock:
            if self._control is None or self._owner != os.getpid():
                self._begin()
        return True

    def connect(self, asked: dict[str, Any]) -> "Connection | None":
        """Returns a connection to a new fork; None where the system has no forks."""
        if not self.begin():
            return None
        from multiprocessing import Pipe

        ours, theirs = Pipe()
        with self._lock:
            for _ in range(2):  # it may have been killed
                if self._control is None or self._owner != os.getpid():
                    self._begin()
                assert self._control is not None
                try:
                    message = json.dumps(asked).encode()
                    socket.send_fds(self._control, [message], [theirs.fileno()])
                    break
                except OSError:
                    self.close()
        theirs.close()
        return ours

    def _begin(self) -> None:
        self._control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._owner = os.getpid()
        path = os.pathsep.join(p for p in sys.path if p)
        environment = os.environ | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-P", "-m", "tomojax.files.reader"]
        with other:
            self._process = subprocess.Popen(
                command,
                stdin=other.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment,
            )

    def close(self) -> None:
        """Ends the process, with the forks that nobody asks any more."""
        if self._control is not None:
            self._control.close()
            self._control = None
        if self._process is not None and self._owner == os.getpid():
            try:
                self._process.wait(5)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._process = None


readers = Readers()
atexit.register(readers.close)
