"""Names that commands take: known at once, where the rooms that have them import JAX.

Tests hold these tables to the rooms' own.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tomojax._require import one_of, require

METHODS = ("auto", "source", "linear", "points", "shape")

# Patterns that ask for no contact, and those that do.
FIXED = ("all", "boundary", "v_line", "edge", "random_16", "random_8")
POLICIES = (*FIXED, "around", "cop_line", "point", "around_contacts", "information")


# The sensor where no recording tells of another: size, m, and number of electrodes.
SIZE, ELECTRODES = (0.16, 0.16), 64


def sheet_of(like: Path | None) -> tuple[Any, Any, int]:
    """Finds the rig of a recording, or None, with the sheet's size, m, and electrodes.

    **Raises:** `ValueError` for a file that is no recording.
    """
    if like is None:
        return None, SIZE, ELECTRODES
    from tomojax.recordings import open_recording

    with open_recording(like) as recording:
        return recording.rig, recording.rig.size, recording.electrodes


def check_name(option: str, got: str, names: Sequence[str], more: str = "") -> None:
    """**Raises:** `ValueError` for what is none of `names`; `more`: what else may be."""
    require(got in names, option, repr(got), one_of(got, names) + more)


def ground_numbers(
    option: str, text: str, electrodes: int | None = None
) -> list[int] | None:
    """Reads electrodes with commas, "0,7,14"; None for a name.

    **Raises:** `ValueError` for other numbers, and for electrodes beyond so many.
    """
    if not text or set(text) - set("0123456789,- "):
        return None
    try:
        found = [int(part) for part in text.split(",")]
    except ValueError:
        found = [-1]
    last = "" if electrodes is None else f" to {electrodes - 1}"
    inside = all(0 <= e and (electrodes is None or e < electrodes) for e in found)
    require(inside, option, repr(text), f"electrodes from 0{last} with commas")
    return found
