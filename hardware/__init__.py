"""The bridge: brings measured slots from rigs into the compiled step, and grounds back.

The bridge moves slots and knows no physics. `open_source` opens a source by its name. `run`
is the live loop. A `loop.recorder.Recorder` writes recordings beside the loop. PROTOCOL.md
describes a rig's side.
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
