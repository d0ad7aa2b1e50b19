"""Runs one sink beside the live loop.

    python -m tomojax.hardware.sinks.run RING TOLD NAME

The process reads the ring and gives way to the loop. The loop goes on, whatever happens to
this process or to its listeners.
"""

import argparse
import json
import math
import os
import signal
import sys
from contextlib import suppress
from typing import Any

from tomojax.hardware.loop import beside, SlotRing
from tomojax.hardware.sinks._rows import follow, Force, Sink
from tomojax.hardware.sinks._where import parse, Where

# How much it gives way to the loop.
_NICE = 5


def open_sink(where: Where, ring: SlotRing) -> Sink:
    """Opens the sink of a parsed name."""
    if where.kind == "udp":
        from tomojax.hardware.sinks._udp import UdpSink

        return UdpSink(where)
    if where.kind == "jsonl":
        from tomojax.hardware.sinks._jsonl import JsonSink

        return JsonSink(where)
    if where.kind == "osc":
        from tomojax.hardware.sinks._osc import OscSink

        return OscSink(where)
    if where.kind == "lsl":
        from tomojax.hardware.sinks._lsl import LslSink

        return LslSink(where, ring.contacts)
    from tomojax.hardware.sinks._foxglove import FoxgloveSink

    return FoxgloveSink(where, ring)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("ring", "told", "name"):
        parser.add_argument(name)
    parser.add_argument("force", nargs="?", default="null")
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the live loop's
    beside()
    with suppress(AttributeError, OSError):
        os.nice(_NICE)
    law: Any = json.loads(given.force)
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
