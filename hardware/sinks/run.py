"""Runs one sink beside the live loop.

    python -m tomojax.hardware.sinks.run RING TOLD NAME --force LAW

The process reads the ring and gives way to the loop. The loop goes on, whatever happens to
this process or to its listeners.
"""

import json
import math
import os
import sys
from importlib import import_module

from tomojax.hardware.loop import begun, SlotRing
from tomojax.hardware.sinks._rows import follow, Force, Sink
from tomojax.hardware.sinks._where import parse, Where

# How much it gives way to the loop.
_NICE = 5


def open_sink(where: Where, ring: SlotRing) -> Sink:
    """Opens the sink of a parsed name: a class in the kind's own module."""
    module = import_module(f"tomojax.hardware.sinks._{where.kind}")
    return getattr(module, f"{where.kind.title()}Sink")(where, ring)


def main() -> None:
    given = begun(__doc__, "ring", "told", "name", "--force", nice=_NICE)
    law = json.loads(given.force or "null")
    force = Force(*law) if law else lambda conductance: math.nan
    where, ring = parse(given.name), SlotRing(given.ring, writable=False)
    try:
        sink = open_sink(where, ring)
        counted = follow(ring, sink, json.loads(given.told), where.rate, force)
    except (OSError, ValueError) as error:
        told = f"tomojax: {given.name}: {error}; nothing more goes there"
        print(told, file=sys.stderr, flush=True)
        os._exit(1)  # Python's own end would write once more to a reader that is gone
    lost = f", {counted.lost} lost: it was too slow" if counted.lost else ""
    thin = f", {counted.thinned} left out by rate" if counted.thinned else ""
    print(f"{given.name}: {counted.sent} rows{thin}{lost}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
