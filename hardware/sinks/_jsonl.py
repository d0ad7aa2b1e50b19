"""JSON lines: writes one for each row and each event, to a file or standard output."""

import json
import math
import sys
import time
from typing import Any

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._rows import LiveRow
from tomojax.hardware.sinks._where import Where

# Between flushes, s: a file is read while it grows.
_EVERY = 0.1


class JsonlSink:
    """A file of JSON lines whose keys have units; an unknown number is null.

    A row is {"t_s", "slot", "flags", "contacts": [{"number", "x_m", …}]}. An event is
    {"t_s", "event", "contact", "x_m", "y_m", "conductance_S", "force_N"}.
    """

    def __init__(self, where: Where, ring: SlotRing):
        self._own = where.path != "-"
        self._file = open(where.path, "x", encoding="utf-8") if self._own else sys.stdout
        self._due = 0.0

    def put(self, row: LiveRow) -> None:
        self._write(row_as_json(row))

    def event(self, event: Event, row: LiveRow | None) -> None:
        self._write(event_as_json(event))

    def _write(self, told: dict[str, Any]) -> None:
        self._file.write(json.dumps(told, separators=(",", ":")) + "\n")
        now = time.monotonic()
        if now > self._due:
            self._due = now + _EVERY
            self._file.flush()

    def close(self) -> None:
        self._file.flush()
        if self._own:
            self._file.close()


def row_as_json(row: LiveRow) -> dict[str, Any]:
    """Returns a row by keys with units."""
    contacts = [
        {"number": one.number, **_known((one.x, one.y), one.conductance, one.force)}
        for one in row.contacts
    ]
    return {"t_s": row.t, "slot": row.slot, "flags": row.flags, "contacts": contacts}


def event_as_json(event: Event) -> dict[str, Any]:
    """Returns an event by keys with units."""
    told = {"t_s": event.t, "event": event.kind, "contact": event.contact}
    return told | _known(event.xy, event.conductance, event.force)


def _known(
    xy: tuple[float, float], conductance: float, force: float
) -> dict[str, float | None]:
    told = {"x_m": xy[0], "y_m": xy[1], "conductance_S": conductance, "force_N": force}
    return {name: value if math.isfinite(value) else None for name, value in told.items()}
