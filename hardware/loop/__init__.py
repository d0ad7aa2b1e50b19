"""The live loop, and the recorder and the views that run beside it.

The room carries slots from a source into a step, and grounds back. The room does not know
how a source or a step works.
"""

from tomojax.hardware.loop._leftovers import own_folder as own_folder
from tomojax.hardware.loop._live import run as run
from tomojax.hardware.loop._real_time import begun as begun, real_time as real_time
from tomojax.hardware.loop._ring import SlotRing as SlotRing
from tomojax.hardware.loop._told import (
    answered as answered,
    counted_text as counted_text,
    flags_text as flags_text,
    latency_text as latency_text,
    load_text as load_text,
)
