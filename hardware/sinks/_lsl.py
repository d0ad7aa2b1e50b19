"""Lab Streaming Layer: sends contacts as numbers, events as markers, on its clock."""

import time
from typing import Any

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._rows import LiveRow
from tomojax.hardware.sinks._where import Where

# Seconds that samples are on their way at most.
_UNDER_WAY = 1.0

_OF_CONTACT = {"number": "1", "x": "m", "y": "m", "conductance": "S", "force": "N"}


class LslSink:
    """Two streams, NAME and NAME-events.

    NAME has t, flags, count, and five channels of each contact, NaN without a contact.
    NAME-events has texts such as "touch_down 3 0.0312 0.0507". A sample's time is when it
    was sent; `t` has the rig's clock.
    """

    def __init__(self, where: Where, ring: SlotRing):
        import pylsl

        contacts = ring.contacts
        names = {"t": "s", "flags": "1", "count": "1"}
        for k in range(contacts):
            names |= {f"contact{k + 1}_{n}": unit for n, unit in _OF_CONTACT.items()}
        self._contacts = contacts
        info = pylsl.StreamInfo(
            where.path, "Tactile", len(names), pylsl.IRREGULAR_RATE, pylsl.cf_double64
        )
        channels: Any = info.desc().append_child("channels")
        for name, unit in names.items():
            one = channels.append_child("channel")
            one.append_child_value("label", name)
            one.append_child_value("unit", unit)
        self._rows = pylsl.StreamOutlet(info)
        self._events = pylsl.StreamOutlet(
            pylsl.StreamInfo(
                f"{where.path}-events", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string
            )
        )

    def put(self, row: LiveRow) -> None:
        sample = [row.t, float(row.flags), float(len(row.contacts))]
        for one in row.contacts[: self._contacts]:
            sample += [float(value) for value in one]
        missing = self._contacts - len(row.contacts)
        self._rows.push_sample(sample + [float("nan")] * (len(_OF_CONTACT) * missing))

    def event(self, event: Event, row: LiveRow | None) -> None:
        x, y = event.xy
        self._events.push_sample([f"{event.kind} {event.contact} {x:.6g} {y:.6g}"])

    def close(self) -> None:
        # What is under way is lost with the outlet, and nothing tells when it is there.
        if self._rows.have_consumers() or self._events.have_consumers():
            time.sleep(_UNDER_WAY)
        del self._rows, self._events
