"""Sources of slots: serial lines, UDP, converters, recordings, a virtual rig.

The room moves bytes and voltages. The room knows nothing of steps, nor of physics.
"""

from tomojax.hardware.sources._frames import (
    check_grounds as check_grounds,
    Description as Description,
    GROUNDS as GROUNDS,
    pack_command as pack_command,
    pack_description as pack_description,
    pack_row as pack_row,
    pack_slot as pack_slot,
    Row as Row,
    rows_of as rows_of,
    sealed as sealed,
    Slot as Slot,
    slot_size as slot_size,
    START as START,
    STOP as STOP,
    unpack as unpack,
    unpack_command as unpack_command,
    unpack_row as unpack_row,
)
from tomojax.hardware.sources._open import open_source as open_source
from tomojax.hardware.sources._ordered import OrderedSource as OrderedSource
from tomojax.hardware.sources._replay import ReplaySource as ReplaySource
from tomojax.hardware.sources._source import (
    Counters as Counters,
    Got as Got,
    Handed as Handed,
    SlotSource as SlotSource,
)
from tomojax.hardware.sources._udp import UdpSource as UdpSource
from tomojax.hardware.sources._wire import Link as Link, WireSource as WireSource
from tomojax.hardware.sources.checking import check_source as check_source
