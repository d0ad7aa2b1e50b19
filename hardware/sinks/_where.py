"""Parses names of sinks: KIND:WHERE?OPTION=VALUE."""

import math
import re
import socket
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from urllib.parse import parse_qsl

from tomojax._require import require, require_library

# Kind: rows a second at most.
_KINDS: dict[str, float] = {
    "udp": math.inf,
    "jsonl": math.inf,
    "osc": 100.0,
    "foxglove": 60.0,
    "lsl": math.inf,
    "ros2": math.inf,
}

# Kind: the library that it needs; the extra that brings the library has the kind's name.
_LIBRARIES = {"osc": "pythonosc", "foxglove": "foxglove", "lsl": "pylsl"}

# A topic of ROS 2.
_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)

# Letters of a name.
_LONGEST = 4096


class Where(NamedTuple):
    """The parts of a sink's name."""

    kind: str
    path: str  # of a file, or a name; HOST:PORT
    rate: float  # rows a second at most

    @property
    def address(self) -> tuple[str, int]:
        """HOST and PORT."""
        host, _, port = self.path.rpartition(":")
        return host.strip("[]") or "127.0.0.1", int(port)


def parse(name: str) -> Where:
    """Takes a sink's name apart.

    **Raises:** `ValueError` for an unknown kind, a wrong address or an unknown option.
    """
    require(len(name) <= _LONGEST, "send", f"{len(name)} letters", "a name")
    kind, colon, rest = name.partition(":")
    known = ", ".join(f"{one}:…" for one in _KINDS)
    require(colon and kind in _KINDS, "send", repr(name), f"one of {known}")
    path, _, query = rest.partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    unknown = sorted(options.keys() - {"rate"})
    require(not unknown, f"send: {name}", unknown, "the option rate, or none")
    try:
        rate = float(options.get("rate", _KINDS[kind]))
    except ValueError:
        rate = math.nan
    require(rate > 0, f"send: {name}: rate", options.get("rate"), "rows a second")
    path = path.removeprefix("//")
    found = Where(kind, path, rate)
    if kind in ("udp", "osc", "foxglove"):
        port = path.rpartition(":")[2]
        number = int(port) if port.isascii() and port.isdigit() else 0
        expected = "PORT" if kind == "foxglove" else "HOST:PORT"
        whole = kind == "foxglove" or ":" in path
        require(whole and 0 < number < 65536, f"send: {name}", path, expected)
    elif kind == "ros2":
        expected = "a topic of letters, digits, _ and /"
        require(_TOPIC.fullmatch(path), f"send: {name}", path or "nothing", expected)
    else:
        require(path, f"send: {name}", "nothing", "a file, or a name, behind the colon")
    return found


def check(name: str) -> Where:
    """Parses a name, and checks that the sink could be opened now.

    **Raises:** `ValueError` for a missing library, a file that exists, a port in use.
    """
    where = parse(name)
    if where.kind in _LIBRARIES:
        require_library(_LIBRARIES[where.kind], where.kind)
    if where.kind == "ros2" and find_spec("rclpy") is None:
        source = "it comes with ROS 2, not from PyPI: source ROS's setup.bash first"
        raise ValueError(f"send: {name}: rclpy is not installed; {source}")
    if where.kind == "jsonl" and where.path != "-":
        path = Path(where.path)
        require(not path.exists(), f"{path}", "a file", "a new name")
        require(path.absolute().parent.is_dir(), f"{path}", "no such folder", "one")
    if where.kind in ("udp", "osc"):
        try:
            socket.getaddrinfo(*where.address, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise ValueError(f"send: {name}: {error.strerror or error}") from None
    if where.kind == "foxglove":
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", where.address[1]))
            except OSError as error:
                raise ValueError(f"send: {name}: {error.strerror}") from None
    return where


def check_all(names: Sequence[str], written: Path | None = None) -> list[Where]:
    """Checks each name; `written` is a file that something else will write.

    **Raises:** `ValueError` also for two sinks with one file or one port.
    """
    found = [check(name) for name in names]
    taken: dict[object, str] = {}
    if written is not None:
        taken[written.absolute()] = "the recording"
    for name, where in zip(names, found):
        place: object = None
        if where.kind == "jsonl":
            place = where.path if where.path == "-" else Path(where.path).absolute()
        elif where.kind == "foxglove":
            place = where.address
        elif where.kind in ("lsl", "ros2"):
            place = where.path, where.kind
        if place is not None:
            other = f"what {taken.get(place)} has already"
            require(place not in taken, f"send: {name}", other, "another")
            taken[place] = name
    return found
