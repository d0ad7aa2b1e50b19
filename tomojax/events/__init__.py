"""Finds when contacts begin and end, in files and live, and the pressure that they mean.

The folder imports no JAX: processes beside the loop use events.
"""

from tomojax.events._events import (
    Event,
    EventFinder,
    events_of_tracks,
    find_events,
)
from tomojax.events._force import Pressing, pressure_of

__all__ = [
    "Event",
    "EventFinder",
    "Pressing",
    "events_of_tracks",
    "find_events",
    "pressure_of",
]
