"""Reads recordings as MCAP: a message `tomojax_msgs/msg/Slot` each slot, as from ROS 2."""

from pathlib import Path
from typing import Any

from tomojax._require import require
from tomojax.files import open_container
from tomojax.recordings._described import KEYS, sidecar
from tomojax.recordings.formats._memory import MemoryRecording


def open_mcap(path: Path, told: dict[str, Any]) -> MemoryRecording:
    """Opens the recording in an MCAP file.

    The message has the device's time, s, the slot's number, its ground, and the volts of
    all electrodes. The file's metadata record "tomojax" (a JSON value for each key), or a
    .toml file beside, describes the rig.
    **Raises:** `ValueError` for a file without such messages.
    """
    try:
        file = open_container(path, "mcap")
    except (OSError, ValueError) as error:
        raise ValueError(f"file: cannot be read as MCAP ({error})") from None
    with file:
        cut = "cut" in file.attributes
        own = {n: v for n, v in file.attributes.items() if n in KEYS}
        time, number, ground, volts = (
            file.read_whole(name) for name in ("time", "number", "ground", "volts")
        )
    told = {**own, **sidecar(path), **told}
    told.pop("scale", None)  # what is told are volts
    require((number < 2**62).all(), "number", "2^62 or more", "numbers of slots")
    made = MemoryRecording(path, told, volts, ground, time, number.astype("i8"))
    if cut:
        said = f"the file is cut off or damaged: its first {len(volts)} slots are read"
        made.mended = (said, *made.mended)
    return made
