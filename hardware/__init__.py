"""The bridge: measured slots from rigs into the compiled step, its grounds back.

It moves slots and knows no physics. `open_source` gives a source by its name, `run` is
the live loop, `Recorder` writes recordings beside it; PROTOCOL.md is a rig's side.
"""

from tomojax.hardware._live import run as run
from tomojax.hardware._real_time import real_time as real_time
from tomojax.hardware._replay import ReplaySource as ReplaySource
from tomojax.hardware._ring import Ring as Ring
from tomojax.hardware._source import (
    Counters as Counters,
    Got as Got,
    SlotSource as SlotSource,
)
from tomojax.hardware._sources import open_source as open_source
from tomojax.hardware._udp import UdpSource as UdpSource
