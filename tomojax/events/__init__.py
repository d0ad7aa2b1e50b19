"""Finds when contacts begin and end, in files and live.

The folder imports no JAX: processes beside the loop use events.
"""

from tomojax.events._events import (
    Event as Event,
    EventFinder as EventFinder,
    events_of_tracks as events_of_tracks,
    find_events as find_events,
)

__all__ = ["Event", "EventFinder", "events_of_tracks", "find_events"]
