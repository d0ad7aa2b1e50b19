"""The bridge: measured slots from rigs into the compiled step, its grounds back.

It moves slots and knows no physics. `open_source` gives a source by its name, `run` is
the live loop, a `Recorder` writes recordings beside it; PROTOCOL.md is a rig's side.
"""

from tomojax.hardware.loop import real_time as real_time, run as run, SlotRing as SlotRing
from tomojax.hardware.sources import (
    Counters as Counters,
    Got as Got,
    open_source as open_source,
    OrderedSource as OrderedSource,
    ReplaySource as ReplaySource,
    SlotSource as SlotSource,
    UdpSource as UdpSource,
)
