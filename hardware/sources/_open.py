"""Opens sources by their names."""

import os
from typing import Any

from tomojax._require import require, require_library
from tomojax.hardware.sources._source import SlotSource
from tomojax.recordings import between, open_recording

# Letters of a name: a path has no more.
_LONGEST = 4096


def open_source(where: str, electrodes: int = 64, **options: Any) -> SlotSource:
    """Opens the source that `where` names.

    `where` is serial:PORT, udp://HOST:PORT, ni:INPUTS,LINES or a recording's path.

    **Arguments:** `options` depend on the source: `baud`; `bind`, the address of this
    machine to listen at (by default only this machine reaches it); `speed`, `since` and
    `until` of a recording; `rate`, `settle` and `convert` of `NiSource`; `conditions`
    (L, M), S, a table of ground conditions for a rig that takes one.
    **Raises:** `ValueError` for other names and options.
    """
    require(len(where) <= _LONGEST, "source", f"{len(where)} letters", "a name")
    try:
        if where.startswith("serial:"):
            for name in ("serial", "cobs"):
                require_library(name, "serial")
            from tomojax.hardware.sources.serial import SerialSource

            port = where.removeprefix("serial:")
            if port.startswith("/") and not os.path.exists(port):
                raise ValueError(f"source: {port}: no such port")
            return SerialSource(port, electrodes=electrodes, **options)
        if where.startswith("ni:"):
            from tomojax.hardware.sources.ni import NiSource

            inputs, comma, lines = where.removeprefix("ni:").partition(",")
            if not comma:
                raise ValueError(f"source: got {where!r}, expected ni:INPUTS,LINES")
            return NiSource(inputs, lines, electrodes=electrodes, **options)
        if where.startswith("udp://"):
            from tomojax.hardware.sources._udp import UdpSource

            host, colon, port = where.removeprefix("udp://").rpartition(":")
            if not colon or not (port.isascii() and port.isdigit()):
                raise ValueError(f"source: got {where!r}, expected udp://HOST:PORT")
            return UdpSource(host, int(port), electrodes=electrodes, **options)
        from tomojax.hardware.sources._replay import ReplaySource

        named = os.path.exists(where) or os.path.splitext(where)[1] and ":" not in where
        expected = "serial:PORT, udp://HOST:PORT, ni:INPUTS,LINES, a recording's path, "
        expected += "or virtual in a command"
        require(named, "source", repr(where), expected)
        options.pop("conditions", None)  # a recording has its own
        stretch = (options.pop(name, None) for name in ("since", "until"))
        return ReplaySource(between(open_recording(where), *stretch), **options)
    except TypeError as error:
        reason = str(error).rpartition(" ")[2]
        raise ValueError(f"source: {where} has no option {reason}") from None
