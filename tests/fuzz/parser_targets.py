"""The parsers that `parsers.py` fuzzes: each is given bytes, and fails on a finding."""

import contextlib
import io
import math
import os
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np


class Bytes:
    """A parser's input as the choices that it stands for; zeros after its end."""

    def __init__(self, data: bytes):
        self._data, self._at = data, 0

    def take(self, count: int) -> bytes:
        found = self._data[self._at : self._at + count]
        self._at += count
        return found.ljust(count, b"\0")

    def number(self, size: int = 1) -> int:
        return int.from_bytes(self.take(size), "little")

    def rest(self) -> bytes:
        return self._data[self._at :]

    @property
    def left(self) -> bool:
        return self._at < len(self._data)


@contextlib.contextmanager
def one_line() -> Iterator[None]:
    """Lets through what a parser may say."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        if not text or "\n" in text or len(text) > 5000:
            raise Said(text[:300]) from error


class Said(Exception):
    """What a parser said is no line."""


def finite(*values: Any) -> None:
    for value in values:
        assert np.isfinite(np.asarray(value, float)).all(), f"accepted: {value!r}"


# ---- messages ------------------------------------------------------------------------


def _message(data: Bytes, electrodes: int) -> bytes:
    """Bytes as they come, or with the length and the checksum of what they might be."""
    from tomojax.hardware import sources as frames

    way = data.number()
    sizes = {1: frames.slot_size(electrodes) - 4, 2: 36, 3: 4 + electrodes}
    if way & 8:
        sizes |= {2: 44, 3: 12 + 4 * electrodes}
    size = sizes.get(way & 3)
    body = data.take(data.number() if size is None else size)
    return frames.sealed(body) if way & 4 else body


def messages(data: bytes) -> None:
    """What is taken for a message is one: packed again it has the same bytes."""
    from tomojax.hardware import sources as frames

    given = Bytes(data)
    m = 1 + given.number()
    message = _message(given, m)
    found = frames.unpack(message, m)
    if isinstance(found, frames.Slot):
        assert 0 <= found.ground < m and found.codes.shape == (m,)
        assert frames.pack_slot(*found) == message
    elif found is not None:
        numbers = found.rate, found.scale, found.offset
        sound = all(map(math.isfinite, numbers))
        assert not sound or frames.pack_description(found) == message
    command = frames.unpack_command(message, m)
    if command is not None:
        assert len(command[1]) <= m and all(g < m for g in command[1])
        assert frames.pack_command(*command) == message
    row = frames.unpack_row(message, m)
    if row is not None:
        assert row.row < row.rows <= 256 and (row.conductances >= 0).all()
        assert frames.pack_row(row) == message


def serial(data: bytes) -> None:
    """Messages of a serial line do not depend on where reads of it end."""
    from tomojax.hardware.sources.serial import Frames

    given = Bytes(data)
    longest, step, line = given.number() + 8, given.number() + 1, given.rest()
    whole, cut = Frames(longest)(line), Frames(longest)
    pieces = [line[k : k + step] for k in range(0, len(line), step)]
    parts = [message for piece in pieces for message in cut(piece)]
    assert parts == whole, "depends on where reads end"
    assert all(len(message) <= longest + 2 for message in whole)


class _Ended(Exception):
    """The link has no more messages."""


def wire(data: bytes) -> None:
    """Any messages of a rig, at any times: slots in order, at finite times."""
    from tomojax.hardware import sources as frames

    given = Bytes(data)
    m, later = 1 + given.number() % 8, 0.0

    class Scripted(frames.Link):
        def open(self) -> None: ...
        def send(self, message: bytes) -> None: ...
        def close(self) -> None: ...

        def receive(self, timeout: float) -> tuple[list[bytes], float]:
            nonlocal later
            if not given.left:
                raise _Ended
            later += 1e-4 * given.number() ** 2
            return [_message(given, m)], time.perf_counter() + later

    source, codes, due = frames.WireSource(Scripted(), m), np.zeros(m, np.int16), 0
    with contextlib.suppress(_Ended), one_line():
        source.start()
        finite(source.rate)
        ends = np.array([-32768, 32767], np.float32) * np.float32(source.scale)
        finite(ends + np.float32(source.offset))
        while True:
            got = source.read(codes, 1.0)
            assert got is not None and 0 <= got.ground < m and got.lost >= 0
            finite(got.time, got.arrived)
            assert got.number == due + got.lost, "numbers do not go on"
            due = got.number + 1


# ---- text ----------------------------------------------------------------------------


def _text(data: bytes) -> str:
    """A line that a user gives: what has several may be told as it is."""
    return data.decode("utf-8", errors="surrogateescape").replace("\n", " ")


def source(data: bytes) -> None:
    """The name of a source."""
    from tomojax.hardware import open_source

    given = Bytes(data)
    prefixes = "", "udp://", "udp://localhost:", "serial:", "ni:", "/dev/", "/proc/self/"
    where = prefixes[given.number() % len(prefixes)] + _text(given.rest())
    with one_line():
        open_source(where, 1 + given.number())


def _folder() -> Path:
    global _FOLDER
    if _FOLDER is None:
        shared = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        _FOLDER = tempfile.TemporaryDirectory(dir=shared)
    return Path(_FOLDER.name)


_FOLDER: tempfile.TemporaryDirectory | None = None


def _file(name: str, content: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(content)
    return path


def calibration(data: bytes) -> None:
    """A calibration's file: what it corrects stays finite, in float32 too."""
    import tomojax as tx

    path = _file("rig.json", data)
    with one_line():
        found = tx.Calibration.load(path, 3)
        ones = np.ones(3, np.float32)
        finite(found.voltages(ones), found.readings(ones), found.age_hours())
        for value in (found.sheet, found.electrodes, found.error, found.own, found.ground):
            finite(np.asarray(value, np.float32))
        finite(np.float32(found.noise or 0.0), np.float32(found.pressure or 0.0))
        found.save(path)
        assert tx.Calibration.load(path, 3) == found, "saved otherwise"


def packed(data: bytes) -> bytes:
    """An .npz file: as it comes, or arrays that are packed as they should be."""
    given = Bytes(data)
    if given.number() % 4 == 0:
        return given.rest()
    pack = io.BytesIO()
    with zipfile.ZipFile(pack, "w") as file:
        while given.left:
            name = ("table", "idle", "size", "lam", "xy")[given.number() % 5]
            if f"{name}.npy" not in file.namelist():
                file.writestr(f"{name}.npy", given.take(min(given.number(2), 4096)))
    return pack.getvalue()


def policy(data: bytes) -> None:
    """A table of grounds by place."""
    import tomojax as tx

    global _SENSOR
    _SENSOR = _SENSOR or tx.Sensor.grid(4, 4, divisions=(16, 16))
    with one_line():
        found = tx.step.load_policy(_file("table.npz", packed(data)), _SENSOR)
        table, idle = np.asarray(found.table), np.asarray(found.idle)
        assert table.size and 0 <= min(table.min(), idle.min())
        assert max(table.max(), idle.max()) < 16, "grounds that there are not"
        if found.lam is not None:
            finite(found.lam)
            assert (np.asarray(found.lam) > 0).all(), "no λ"


_SENSOR: Any = None


def places(data: bytes) -> None:
    """Places of a touch, as a text or as arrays."""
    import tomojax as tx

    text = data[:1] != b"\0"
    path = _file("xy.csv" if text else "xy.npz", data[1:] if text else packed(data[1:]))
    with one_line():
        found = tx.calibration.read_places(path)
        assert found.ndim == 2 and found.shape[1] == 2 and found.dtype == float


def _parsed(command: str, words: list[str]) -> dict[str, Any] | None:
    """A command's options, without the command; None where they are refused."""
    import click

    from tomojax.cli.app import app

    try:
        with contextlib.redirect_stdout(io.StringIO()):
            context = app.commands[command].make_context(command, words)
        return context.params
    except click.exceptions.Exit:  # --help
        return None
    except click.ClickException as error:
        text = error.format_message()
        if not text.strip() or "\n" in text.strip():
            raise Said(text[:300]) from error
        return None


def _numbers_of(options: dict[str, Any]) -> None:
    for name, value in options.items():
        each = value if isinstance(value, (list, tuple)) else [value]
        for one in each:
            if isinstance(one, (int, float)):
                assert math.isfinite(one), f"accepted: {name} {value!r}"
        if name in ("seconds", "file_seconds", "speed", "budget", "baud", "contacts"):
            assert value is None or value > 0, f"accepted: {name} {value!r}"


def config(data: bytes) -> None:
    """A TOML file of `tomojax record` or `live`."""
    words = ["virtual", "--config", str(_file("c.toml", data[1:]))]
    with one_line():
        if data[:1] == b"\1":
            found = _parsed("live", words)
        else:
            found = _parsed("record", [*words, "-o", "o.h5"])
        _numbers_of(found or {})


def options(data: bytes) -> None:
    """Words of any command line, with zero bytes between."""
    from tomojax.cli.app import app

    names = sorted(app.commands)
    words = [_text(w) for w in data[1:].split(b"\0")]
    with one_line():
        _numbers_of(_parsed(names[(data[:1] or b"\0")[0] % len(names)], words) or {})
