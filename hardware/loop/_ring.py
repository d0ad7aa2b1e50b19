"""A ring of slots and their contacts in shared memory: one process writes, many read.

The writer never waits. A reader that falls behind by more than the ring's length loses the
oldest slots. That reader is told how many slots are lost, and no other process waits.
"""

import json
import os
import tempfile
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.hardware.loop._leftovers import abandoned, claim, sweep
from tomojax.hardware.sources import Counters

SIDE = 32  # pixels of a side of the image that goes along
LONGEST = 20_000  # µs of the longest latency in the histogram
SAID = 2048  # bytes of what is said beside the slots
MARKS = 64  # that wait for the recorder
MARK = 80  # bytes of a mark's text (UTF-8)
_TOLD = ".rig"  # ends the name of the file beside a ring

# What a source counts, and slots that were recorded but not worked on: newer ones waited.
_NAMES = (*Counters().as_dict(), "skipped")

_HEAD = np.dtype(
    [
        ("rows", "i8"),  # written so far
        ("recorded", "i8"),  # of them in a file that is flushed, or told lost there
        ("number", "i8"),  # of the slot after those
        ("dropped", "i8"),  # of them that no recorder was in time for
        ("done", "i8"),  # whether the writer has ended
        ("counters", "i8", len(_NAMES)),
        ("latency", "i8", LONGEST),
        ("image", "f4", (SIDE, SIDE)),
        ("said", f"S{SAID}"),  # lines of UTF-8 for those who watch
        ("marks", "i8"),  # moments that somebody has marked, so far
        ("marked", "i8"),  # of them in a file that is flushed
        ("mark_t", "f8", MARKS),  # of the rig's clock, s
        ("mark_text", f"S{MARK}", MARKS),
    ]
)


def _row(electrodes: int, contacts: int) -> np.dtype:
    return np.dtype(
        [
            ("number", "i8"),
            ("lost", "i8"),
            ("time", "f8"),  # of the rig's clock, s
            ("latency", "f4"),  # last byte to ground command, s; NaN where not worked on
            ("ground", "i2"),
            ("next", "i2"),
            ("flags", "u4"),
            ("count", "u1"),
            ("xy", "f4", (contacts, 2)),
            ("conductance", "f4", (contacts,)),
            ("codes", "<i2", (electrodes,)),
        ]
    )


def mark_bytes(text: str) -> bytes:
    """Returns a mark's text as bytes for a file: one line, cut between letters."""
    line = "".join(c if c.isprintable() else " " for c in text).strip()
    return line.encode(errors="replace")[:MARK].decode(errors="ignore").encode()


class SlotRing:
    """`SlotRing.create` makes a ring, `SlotRing(path)` opens the ring in another process.

    `head` has numbers beside the rows, each an array that can be written into. `trim` (2,
    M) has a factor and an offset, V, of each channel. The loop works on readings times the
    factor plus the offset. The process that follows the rig's drift writes `trim`.

    A row has what came (`number`, `ground`, `lost`, `time`, s, `codes`) and
    what was answered: `next`, the ground to come, `count` contacts with `xy`, m, and
    `conductance`, S, strongest first, `flags`, and `latency`, s. A slot that a newer one
    overtook has no answer: `next` is −1 and `latency` NaN. `counted()` has the numbers of
    `Counters`, and `skipped`, slots without an answer.
    """

    def __init__(self, path: Path | str, writable: bool = True):
        self.path = Path(path)
        m, contacts, length = np.fromfile(self.path, "i8", 3).tolist()
        mode = "r+" if writable else "r"
        # As plain arrays: reading from a memmap takes microseconds.
        head = np.asarray(np.memmap(self.path, _HEAD, mode, 64, 1))
        self.head = {name: head[name][0, ...] for name in _HEAD.names or ()}
        start = 64 + _HEAD.itemsize
        self.trim = np.asarray(np.memmap(self.path, "f4", mode, start, (2, m)))
        start += self.trim.nbytes
        self.rows = np.asarray(np.memmap(self.path, _row(m, contacts), mode, start, length))
        self.electrodes, self.contacts, self.length = m, contacts, length
        # Fields by themselves: writing into one costs a tenth of writing a row.
        self._fields = {name: self.rows[name] for name in self.rows.dtype.names or ()}

    @classmethod
    def create(
        cls, electrodes: int, contacts: int = 2, length: int = 1 << 16, folder: Any = None
    ) -> "SlotRing":
        """Makes a ring of `length` slots, in memory where the system has a folder for that.

        Rings of killed processes are removed from the folder.
        """
        require(length >= 2, "length", length, "2 or more slots")
        shared = Path("/dev/shm")
        place = folder or (shared if shared.is_dir() else tempfile.gettempdir())
        sweep(Path(place), "tomojax-*.ring")
        for path in Path(place).glob(f"tomojax-*{_TOLD}"):
            with suppress(OSError):  # another user's
                if not path.with_suffix(".ring").exists():
                    path.unlink()
        while True:
            number, name = tempfile.mkstemp(prefix="tomojax-", suffix=".ring", dir=place)
            own = claim(Path(name))
            if own is not None or Path(name).exists():  # there are no locks here
                break
            os.close(number)  # another session has swept it before it was claimed
        head = 64 + _HEAD.itemsize + 8 * electrodes
        size = head + length * _row(electrodes, contacts).itemsize
        with os.fdopen(number, "wb") as file:
            file.write(np.array([electrodes, contacts, length], "i8").tobytes())
            file.truncate(size)
        made = cls(name)
        made.trim[0] = 1
        if own is not None:
            weakref.finalize(made, os.close, own)
        return made

    @property
    def done(self) -> bool:
        """Whether the writer has ended, by itself or because it was killed."""
        return bool(self.head["done"]) or abandoned(self.path)

    def put(self, got: Any, codes: np.ndarray, said: dict[str, Any]) -> None:
        """Writes one more slot: a `Got`, its codes, and the other fields by name."""
        written = int(self.head["rows"])
        k = written % self.length
        fields = self._fields
        fields["number"][k], fields["lost"][k] = got.number, got.lost
        fields["time"][k], fields["ground"][k] = got.time, got.ground
        fields["codes"][k] = codes
        for name, value in said.items():
            fields[name][k] = value
        self.head["rows"][...] = written + 1

    def since(self, row: int, most: int = 1 << 14) -> tuple[np.ndarray, int, int]:
        """Returns a copy of the first `most` rows from `row` on.

        Then come the row to go on with, and how many rows are gone already.
        """
        end = int(self.head["rows"])
        # One that is written into just now is no row any more.
        first = max(row, end - self.length + 1)
        stop = min(end, first + most)
        found = self.rows[np.arange(first, stop) % self.length]
        still = max(0, int(self.head["rows"]) - self.length + 1 - first)
        gone = first - row + min(still, stop - first)
        return found[still:], stop, gone

    def follow(
        self, every: float, row: int, most: int = 1 << 14
    ) -> Iterator[tuple[np.ndarray, int]]:
        """Yields rows from `row` on, and how many are gone, until the ring is done.

        The next look comes `every` s later, or at once where more than `most` rows wait.
        """
        done, waiting = False, True
        while waiting or not done:
            done = self.done
            rows, row, gone = self.since(row, most)
            yield rows, gone
            waiting = len(rows) == most
            time.sleep(0 if done or waiting else every)

    def count(self, **numbers: int) -> None:
        for name, value in numbers.items():
            self.head["counters"][_NAMES.index(name)] = value

    def counted(self) -> dict[str, int]:
        return dict(zip(_NAMES, self.head["counters"].tolist()))

    def latency(self, *parts: float) -> list[float]:
        """Returns quantiles of all latencies so far, s; NaN before the first."""
        total = np.cumsum(self.head["latency"])
        if not total[-1]:
            return [float("nan")] * len(parts)
        return [1e-6 * float(np.searchsorted(total, p * total[-1])) for p in parts]

    def say(self, text: str) -> None:
        """Replaces the lines of text beside the slots; text that is too long is cut."""
        coded = text.encode()[:SAID]
        self.head["said"][...] = coded.decode(errors="ignore").encode()

    def said(self) -> str:
        """Reads the lines that `say` put there last."""
        return bytes(self.head["said"][()]).decode(errors="ignore")

    def mark(self, text: str) -> float:
        """Marks the newest slot's moment for the recorder; returns the moment's time, s.

        Only one process marks. A text that is too long is cut.
        **Raises:** `ValueError` before the first slot, or where the recorder is late.
        """
        rows, marks = int(self.head["rows"]), int(self.head["marks"])
        require(rows, "mark", "no slot yet", "a moment of the recording")
        waiting = marks - int(self.head["marked"])
        require(waiting < MARKS, "mark", f"{waiting} that wait", "a recorder in time")
        t = float(self.rows["time"][(rows - 1) % self.length])
        self.head["mark_t"][marks % MARKS] = t
        self.head["mark_text"][marks % MARKS] = mark_bytes(text)
        self.head["marks"][...] = marks + 1
        return t

    def unrecorded_marks(self) -> list[tuple[float, bytes]]:
        """Returns the marks that no file has yet, the oldest first."""
        numbers = range(int(self.head["marked"]), int(self.head["marks"]))
        t, text = self.head["mark_t"], self.head["mark_text"]
        return [(float(t[k % MARKS]), bytes(text[k % MARKS])) for k in numbers]

    def beside(self, told: dict[str, Any]) -> str:
        """Puts a rig's attributes beside the ring; returns the word that `begun` reads.

        A curved sheet's are longer than a word of a command may be.
        """
        path = self.path.with_suffix(_TOLD)
        path.touch(0o600)
        path.write_text(json.dumps(told))
        return f"@{path}"

    def remove(self) -> None:
        """Removes the ring's file; processes that have it open keep it until they end."""
        for path in (self.path, self.path.with_suffix(_TOLD)):
            with suppress(PermissionError):  # Windows keeps a file that is open
                path.unlink(missing_ok=True)
