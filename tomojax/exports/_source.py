"""Reads a stretch of a results file in blocks of rows, for writers of other formats."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax._stretch import stretch_of
from tomojax.events import Event, EventFinder, events_of_tracks
from tomojax.recordings import Progress as Progress
from tomojax.results.loading import LoadedResults

# Numbers that are read at once: a block of images of 32 × 32 is of 4096 rows.
_BLOCK = 1 << 22


# Of each field what it is, in words; their units are in the file.
WORDS = {
    "t": "time",
    "contact_count": "contacts of the row",
    "contact_xy": "place of a contact",
    "contact_x": "place of a contact along x",
    "contact_y": "place of a contact along y",
    "contact_xyz": "place of a contact in space",
    "contact_normal": "normal of the sheet at a contact",
    "contact_radius": "radius of a contact",
    "contact_angle": "direction of a long contact, from x",
    "contact_current": "current through a contact",
    "contact_conductance": "conductance of a contact",
    "contact_conductance_error": "standard deviation of the logarithm of the conductance",
    "contact_strength": "strength of a press, of a usual one",
    "contact_strength_error": "standard deviation of the logarithm of the strength",
    "contact_force": "force of a contact",
    "contact_track": "number of a contact, 0 where there is none",
    "contact_covariance": "covariance of a place: xx, yy, xy",
    "residual": "root mean square of what the model leaves unexplained",
    "flags": "bits of tomojax.Flag",
    "rung": "model that answered",
    "image": "image of the contact",
    "residual_by_electrode": "what the model leaves unexplained, by electrode",
    "touch": "probability that a pixel touches",
    "image_deviation": "standard deviation of the image",
}


class Source:
    """Rows of a results file between two times; a context that closes the file.

    **Arguments:** `since` and `until` s after the file's first row.
    **Raises:** `ValueError` for a file without results, or without a row in the stretch.

    **Example:**

    >>> from pathlib import Path
    >>> from tomojax.exports import Source
    >>> try:
    ...     Source(Path("none.h5"))
    ... except ValueError as error:
    ...     print(error)
    none.h5: no results of reconstruct: file: got none, or a folder, expected a file
    """

    def __init__(
        self, path: Path, since: float | None = None, until: float | None = None
    ) -> None:
        self.path = path
        self._file = file = LoadedResults(path)
        try:
            for name in ("contact_count", "contact_xy", "contact_conductance", "flags"):
                require(name in file.names, name, "none", "this dataset")
            self.start, self.stop = stretch_of(file.read("t"), since, until)
            self.size, self.electrode_xy = file.size(), file.electrode_xy()
            self.box = file.box()
            self.outline = file.outline()
        except ValueError as error:
            file.close()
            text = str(error).removeprefix(f"{path}: ")
            raise ValueError(f"{path}: {text}") from None
        self.rows, self.contacts = self.stop - self.start, file.contacts
        self.names = [name for name in WORDS if name in file.names]
        self.attributes = file.attributes
        self.unit, self.kind = file.unit, file.dtype  # of a field, by its name

    @property
    def pitch(self) -> float:
        """Returns the electrodes' pitch, m, the same as `Sensor.mean_pitch`."""
        return float(np.sqrt(np.prod(self.size) / len(self.electrode_xy)))

    def shape(self, name: str) -> tuple[int, ...]:
        """Returns the shape of one row of a field."""
        return self._file.shape(name)[1:]

    def times(self) -> np.ndarray:
        """Returns the times of all rows, s."""
        return self._file.stretch("t", self.start, self.stop)

    def row(self, name: str, k: int) -> Any:
        """Returns a field of the `k`th row."""
        return self._file.row(name, self.start + k)

    def thinned(self, name: str, step: int) -> np.ndarray:
        """Returns a field of every `step`-th row."""
        return self._file.thinned(name, step, self.start, self.stop)

    def blocks(
        self, names: list[str], progress: Progress = lambda done, total: None
    ) -> Iterator[dict[str, np.ndarray]]:
        """Yields fields by name, a stretch of rows at a time."""
        width = sum(int(np.prod(self.shape(name))) for name in names)
        each, done = max(1, _BLOCK // max(1, width)), 0
        for block in self._file.blocks(names, each, self.start, self.stop):
            if "contact_count" in block:
                most = int(block["contact_count"].max(initial=0))
                fits = most <= self.contacts
                expected = f"0 to {self.contacts}, as contact_xy has places"
                require(fits, f"{self.path}: contact_count", most, expected)
            yield block
            done = min(done + each, self.rows)
            progress(done, self.rows)

    def events(self) -> list[Event]:
        """Lists touch-downs and lift-offs, by the file's tracks if any, and marks."""
        found = self._tracked() if "contact_track" in self.names else self._found()
        nowhere = (float("nan"), float("nan"))
        first, last = (float(self.row("t", k)) for k in (0, self.rows - 1))
        for t, text in self.marks():
            if first <= t <= last:
                found.append(Event(t, "mark", 0, nowhere, float("nan"), text=text))
        return sorted(found, key=lambda event: event.t)

    def marks(self) -> list[tuple[float, str]]:
        """Lists moments that somebody marked during the recording: s, and words."""
        try:
            told = json.loads(self.attributes.get("marks", "[]"))
            return [(float(t), str(text)) for t, text in told]
        except (TypeError, ValueError, RecursionError):
            got = str(self.attributes.get("marks"))
            raise ValueError(
                f"{self.path}: marks: got {got[:40]}, expected times and texts"
            ) from None

    def _found(self) -> list[Event]:
        # As `EventFinder.rows` takes them.
        names = ["t", "contact_count", "contact_xy", "contact_conductance", "flags"]
        names += [n for n in ("contact_force",) if n in self.names]
        t = self.times()
        interval = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        finder = EventFinder.of_rows(self.pitch, interval)
        found: list[Event] = []
        for block in self.blocks(names):
            found += finder.rows(*block.values())
        return found + finder.finish()

    def _tracked(self) -> list[Event]:
        found: dict[tuple[str, int], Event] = {}
        names = ["t", "contact_track", "contact_xy", "contact_conductance"]
        names += [n for n in ("contact_force",) if n in self.names]
        for block in self.blocks(names):
            for event in events_of_tracks(*block.values()):
                one = event.kind, event.contact
                # Of several blocks the first touch-down, and the last lift-off.
                if event.kind == "lift_off" or one not in found:
                    found[one] = event
        return list(found.values())

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> "Source":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def plain(attributes: dict[str, Any]) -> dict[str, Any]:
    """Makes attributes numbers, lists and texts; values unknown to JSON become text."""
    return {name: _plain(value) for name, value in attributes.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value if isinstance(value, bool | int | float | str) else str(value)
