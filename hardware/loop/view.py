"""Shows the live loop in a terminal: a separate process that reads the ring.

A terminal gets a picture that is drawn again and again. Any other output gets a line each
second.
"""

import sys
import time
from typing import Any

import numpy as np

from tomojax.hardware.loop import _told
from tomojax.hardware.loop._real_time import begun
from tomojax.hardware.loop._ring import SlotRing
from tomojax.kernels.flags import Flag

_EVERY = 0.1  # s

# What steers a terminal: to its first place, clear all, clear the rest of the line.
_HOME = "\x1b[H"
_CLEAR = "\x1b[2J"
_REST = "\x1b[K"


def blocks(image: np.ndarray) -> list[str]:
    """Returns an image as lines of half blocks in grey, x to the right and y upwards."""
    grey = (232 + np.rint(23 * _told.shades(image))).astype(int)
    return [
        "".join(f"\x1b[38;5;{a};48;5;{b}m▀" for a, b in zip(upper, lower)) + "\x1b[0m"
        for upper, lower in zip(grey[::2], grey[1::2])
    ]


def lines(ring: SlotRing, last: Any, rate: float, explained: set[Flag]) -> list[str]:
    """Returns the view's lines of text; flags in `explained` are named alone."""
    behind = int(ring.head["rows"] - ring.head["recorded"])
    recorded = f"{int(ring.head['recorded'])} recorded, {behind} to come"
    dropped = int(ring.head["dropped"])
    found = [
        f"{rate:.0f} slots/s; {_told.counted_text(ring)}",
        _told.load_text(ring),
        _told.latency_text(ring, 0.5, 0.99, 0.999),
        (f"{recorded}, {dropped} NOT" if dropped else recorded)
        if ring.head["recorded"]
        else "not recorded",
    ]
    found = [line for line in found if line] + ring.said().splitlines()
    if last is None:
        return [*found, "no slot yet"]
    flags = Flag(int(last["flags"]))
    names = ", ".join(str(f.name) for f in flags) or "no flags"
    level = f"{flags.level.name.replace('_', ' ')}: " if flags.level else ""
    found.append(f"{last['time']:.3f} s, ground {last['ground']}, {level}{names}")
    for xy, g in zip(last["xy"][: last["count"]], last["conductance"]):
        x, y = 1e3 * xy
        found.append(f"contact at {x:6.2f}, {y:6.2f} mm, {1e6 * g:9.2f} µS")
    found += [_told.flag_text(flag) for flag in flags if flag not in explained]
    return found


def watch(ring: SlotRing, terminal: bool) -> None:
    """Shows the ring until the ring is done."""
    period = _EVERY if terminal else 1.0
    before, rows = time.monotonic(), int(ring.head["rows"])
    explained: set[Flag] = set()
    if terminal:
        print(_CLEAR, end="")
    done = False
    while not done:
        done = ring.done
        time.sleep(0 if done else period)
        now, count = time.monotonic(), int(ring.head["rows"])
        rate, before, rows = (count - rows) / (now - before), now, count
        newest = ring.since(max(0, count - 100))[0]
        worked = newest[np.isfinite(newest["latency"])]
        last = next((some[-1] for some in (worked, newest) if len(some)), None)
        told = lines(ring, last, rate, explained)
        if terminal:
            shown = blocks(ring.head["image"]) + told
            text = "\n".join(line + _REST for line in shown)
            print(_HOME + text + "\n\x1b[J", end="", flush=True)
        else:
            print("; ".join(told), flush=True)
            if last is not None:
                explained |= set(Flag(int(last["flags"])))


def main() -> None:
    ring = SlotRing(begun(__doc__, "ring").ring, writable=False)
    try:
        watch(ring, sys.stdout.isatty())
    except BrokenPipeError:
        pass


if __name__ == "__main__":
    main()
