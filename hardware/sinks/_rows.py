"""Turns a ring's rows into rows for sinks: contacts with numbers and forces, and events."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from tomojax.events import Event, EventFinder, Pressing, pressure_of
from tomojax.hardware.loop import SlotRing

_EVERY = 0.002  # s between looks at the ring
_MOST = 1 << 10  # rows that are read at once


class LiveContact(NamedTuple):
    """One contact of a row."""

    number: int  # 0 until a second row has shown it
    x: float  # m
    y: float  # m
    conductance: float  # S
    force: float  # N; NaN where it is not known


class LiveRow(NamedTuple):
    """The loop's answer to one slot."""

    slot: int  # its number; lost ones count
    t: float  # s, of the rig's clock
    flags: int  # bits of `Flag`
    contacts: list[LiveContact]  # strongest first


@runtime_checkable
class Sink(Protocol):
    """The interface of a sink. A slow sink loses the rows that come meanwhile.

    A sink of your own has these three methods; `follow` calls them.
    """

    def put(self, row: LiveRow) -> bool | None:
        """Takes a row; returns False if the row was not sent."""

    def event(self, event: Event, row: LiveRow | None) -> None:
        """Takes a touch-down or a lift-off, and the row that told it (None at the end)."""

    def close(self) -> None:
        """Ends the sink after all that was put is sent."""


def goes_out(send: Callable[[Any], Any], told: Any) -> bool:
    """Sends something; returns False if it was not sent. Nobody needs to listen."""
    try:
        send(told)
    except OSError as error:  # a full buffer, no network
        return isinstance(error, ConnectionError)
    return True


class Force:
    """The force F, N, of a conductance, by the material's law and a known area.

    The step does not tell a contact's radius. A user who presses with one tip knows it.
    `of` follows the loop of a material with hysteresis; a call gives the loop's middle.

    **Arguments:** `law` and `hysteresis`: a calibration's; `area` m².
    """

    def __init__(self, law: tuple[float, ...], area: float, hysteresis: float = 1.0):
        self._law, self._area, self._hysteresis = law, area, hysteresis
        self._pressing: dict[int, Pressing] = {}

    def __call__(self, conductance: float) -> float:
        p = float(pressure_of(self._law, np.array(conductance / self._area)))
        return self._area * p / math.sqrt(self._hysteresis)

    def of(self, number: int, conductance: float) -> float:
        """Returns the force of a contact by its number, and remembers its way there."""
        if number not in self._pressing:
            self._pressing[number] = Pressing(self._law, self._hysteresis)
        return self._area * self._pressing[number](conductance / self._area)

    def gone(self, number: int) -> None:
        """Forgets a contact."""
        self._pressing.pop(number, None)


class Counted(NamedTuple):
    """Numbers of rows: sent, lost by the sink, and left out because of its rate."""

    sent: int
    lost: int  # it was too slow for them, or they did not go out
    thinned: int


def follow(
    ring: SlotRing,
    sink: Sink,
    told: dict[str, Any],
    rate: float = math.inf,
    force: Callable[[float], float] = lambda conductance: math.nan,
) -> Counted:
    """Gives a sink the loop's past and coming rows until the ring is done.

    **Raises:** `OSError` where the sink cannot go on; the error tells how many rows were
    sent.
    **Arguments:** `told`: `tomojax.recordings.attributes(rig, 1, 0)`; `rate`: rows a
    second at most (all events are sent); `force`: gives N of a conductance, S.
    """
    size, m = np.asarray(told["size"], float), len(told["electrode_xy"])
    pitch = math.sqrt(float(np.prod(size)) / m)
    finder = EventFinder.of_rows(pitch, 1 / float(told["f_switch"]))
    sent = lost = thinned = 0
    due = -math.inf
    for rows, gone in ring.follow(_EVERY, 0, _MOST):
        lost += gone
        for one in rows[np.isfinite(rows["latency"])]:
            row, events = _row(one, finder, force)
            for event in events:
                sink.event(event, row)
            if row.t >= due:
                # In step with the rate, unless rows are slower than that.
                due = max(due + 1 / rate, row.t)
                gone_out = sink.put(row) is not False
                sent, lost = sent + gone_out, lost + (not gone_out)
            else:
                thinned += 1
    for event in finder.finish():
        sink.event(event, None)
    sink.close()
    return Counted(sent, lost, thinned)


def _row(
    one: Any, finder: EventFinder, force: Callable[[float], float]
) -> tuple[LiveRow, list[Event]]:
    n, t, flags = int(one["count"]), float(one["time"]), int(one["flags"])
    xy, g = one["xy"][:n].tolist(), one["conductance"][:n].tolist()
    forces = [force(each) for each in g]
    numbers, events = finder.row(t, xy, g, flags, forces)
    if isinstance(force, Force):
        told = zip(numbers, g, forces)
        forces = [force.of(number, each) if number else f for number, each, f in told]
        for event in events:
            if event.kind == "lift_off":
                force.gone(event.contact)
    contacts = [
        LiveContact(number, x, y, each, f)
        for number, (x, y), each, f in zip(numbers, xy, g, forces)
    ]
    return LiveRow(int(one["number"]), t, flags, contacts), events
