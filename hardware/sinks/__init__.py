"""Sends live contacts to other programs, over the network or into files.

Each sink is a separate process that reads the ring: the loop waits for none.
"""

from tomojax.hardware.sinks._rows import (
    Counted as Counted,
    follow as follow,
    Force as Force,
    LiveContact as LiveContact,
    LiveRow as LiveRow,
    Sink as Sink,
)
from tomojax.hardware.sinks._where import (
    check as check,
    check_all as check_all,
    parse as parse,
    Where as Where,
)
