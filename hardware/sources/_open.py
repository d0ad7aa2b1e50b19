"""Sources by their names."""

from pathlib import Path
from typing import Any

from tomojax._require import require
from tomojax.hardware.sources._source import SlotSource
from tomojax.recordings import open_recording

_LONGEST = 4096  # letters of a name: as many as Linux takes for a path


def open_source(where: str, electrodes: int = 64, **options: Any) -> SlotSource:
    """What `where` names: serial:PORT, udp://HOST:PORT, ni:INPUTS,LINES or a recording.

    **Arguments:** `options` are those of the source: `baud`; `bind`, the address of this
    machine to listen at (by default reached from this machine alone); `speed`, of a
    recording; `rate`, `settle` and `convert` of `NiSource`.
    **Raises:** `ValueError` for other names and options.
    """
    require(len(where) <= _LONGEST, "source", where, f"up to {_LONGEST} letters")
    try:
        if where.startswith("serial:"):
            from tomojax.hardware.sources.serial import SerialSource

            port = where.removeprefix("serial:")
            if port.startswith("/") and not Path(port).exists():
                raise ValueError(f"source: {port}: no such port")
            return SerialSource(port, electrodes=electrodes, **options)
        if where.startswith("ni:"):
            from tomojax.hardware.sources.ni import NiSource

            inputs, comma, lines = where.removeprefix("ni:").partition(",")
            require(comma, "source", repr(where), "ni:INPUTS,LINES")
            return NiSource(inputs, lines, electrodes=electrodes, **options)
        if where.startswith("udp://"):
            from tomojax.hardware.sources._udp import UdpSource

            host, colon, port = where.removeprefix("udp://").rpartition(":")
            told = colon and port.isdecimal() and len(port) < 6
            require(told, "source", repr(where), "udp://HOST:PORT")
            return UdpSource(host, int(port), electrodes=electrodes, **options)
        from tomojax.hardware.sources._replay import ReplaySource

        return ReplaySource(open_recording(where), **options)
    except OSError as error:  # a name that is too long for a file, or a folder of such
        raise ValueError(f"source: {where}: {error.strerror or error}") from None
    except TypeError as error:
        reason = str(error).rpartition(" ")[2]
        raise ValueError(f"source: {where} has no option {reason}") from None
