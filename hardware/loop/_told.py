"""What is said of a loop in sentences: which slots it answers, how soon, and flags."""

import numpy as np

from tomojax.hardware.loop._ring import LONGEST, SlotRing
from tomojax.kernels.flags import Flag

# A loop that answers fewer of its slots than this part is told how to answer more.
_ENOUGH = 0.9

_MORE = (
    "a newer slot waits already for each of the others; to answer more: fewer --contacts, "
    "--real-time, --view none, no other work on this machine, or a lower slot rate"
)


def shades(image: np.ndarray) -> np.ndarray:
    """Scales an image to 0 to 1, y upwards."""
    top = max(float(np.nanmax(image, initial=0)), 1e-30)
    return np.nan_to_num(np.clip(image / top, 0, 1)).T[::-1]


def counted_text(ring: SlotRing) -> str:
    """Says how many slots were given out, and all else that was counted."""
    counted = {name: n for name, n in ring.counted().items() if n}
    slots = counted.pop("slots", 0)
    rest = ", ".join(f"{n} {name}" for name, n in counted.items()) or "nothing lost"
    return f"{slots} slots, {rest}"


def answered(ring: SlotRing) -> float:
    """Gives the part of the slots that the step has answered; NaN before the first."""
    done, skipped = int(ring.head["latency"].sum()), ring.counted()["skipped"]
    return done / (done + skipped) if done + skipped else float("nan")


def load_text(ring: SlotRing) -> str:
    """Says how much of the slots is answered; nothing where no step answers any."""
    part = answered(ring)
    if np.isnan(part):
        return ""
    text = f"answers {100 * part:.0f} % of the slots"
    return text if part >= _ENOUGH else f"{text}: {_MORE}"


def latency_text(ring: SlotRing, *parts: float) -> str:
    """Lists quantiles of the latency, µs; nothing where no slot was answered."""
    each = ring.latency(*parts)
    if not each or np.isnan(each[0]):
        return ""
    last = 1e-6 * (LONGEST - 1)  # whatever takes longer is counted there
    told = (f"{1e6 * q:.0f}" if q < last else f"{LONGEST} or more" for q in each)
    shares = ", ".join(f"{100 * part:.6g}" for part in parts)
    return f"last byte to ground command, {shares} %: {', '.join(told)} µs"


def flag_text(flag: Flag) -> str:
    """Explains one flag: what was seen, and what to do."""
    return f"{flag.name}: {flag.explanation}"


def flags_text(ring: SlotRing) -> list[str]:
    """Lists the flags of the answered slots that are still in the ring, each explained."""
    rows = ring.since(0, ring.length)[0]
    flags = rows["flags"][np.isfinite(rows["latency"])]
    found = []
    for flag in Flag:
        part = float((flags & flag.value > 0).mean()) if len(flags) else 0.0
        if part:
            found.append(f"in {100 * part:.3g} % of the last slots {flag_text(flag)}")
    return found
