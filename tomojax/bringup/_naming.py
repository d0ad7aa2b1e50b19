"""Turns orders of channels and lines into named faults of wiring."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Integer

from tomojax.bringup._fault import Fault
from tomojax.bringup._wiring import lattice, starts, symmetries
from tomojax.bringup.sheet._plane import Plane

# Part of the channels, or of the judged lines, that a mirror or a shift must explain.
_MOST = 0.6

# Slots that agree, of a line that is exchanged with none.
_SURE = 0.85

# Lines that have to be judged for a shift.
_FEW = 3

Order = Integer[np.ndarray, " M"]


def cycles(wrong: dict[int, int]) -> list[tuple[int, ...]]:
    """Groups numbers that are exchanged among themselves."""
    found, left = [], dict(sorted(wrong.items()))
    while left:
        first, second = next(iter(left.items()))
        group = [first]
        del left[first]
        while second in left:
            group.append(second)
            second = left.pop(second)
        found.append(tuple(group))
    return found


def best_image(plane: Plane, electrode: np.ndarray, of: np.ndarray) -> tuple[str, Order]:
    """Finds the symmetry that explains most channels or lines, or "identity"."""
    every = symmetries(plane)
    right = {name: int((image[of] == electrode).sum()) for name, image in every.items()}
    best = max(right, key=lambda name: (right[name], name == "identity"))
    enough = right[best] >= _MOST * len(of) and right[best] > right["identity"]
    name = best if enough else "identity"
    return name, every[name]


def kind_of(name: str) -> str:
    return "turned" if name.startswith("turned") else "mirrored"


def channel_faults(
    plane: Plane,
    electrode: Order,
    lines_too: bool,
    sure: float,
    unknown_which: bool,
    wires: Sequence[tuple[int, ...]],
) -> list[Fault]:
    """Names mirrored, turned and swapped channels; channel c reads `electrode[c]`.

    `lines_too`: ground lines are mirrored with the channels; `wires`: groups whose ground
    lines are swapped as well.
    """
    m = len(electrode)
    numbers = np.arange(m)
    name, image = best_image(plane, electrode, numbers)
    faults = []
    if name != "identity":
        what = (
            "the array, channels and ground lines alike, is"
            if lines_too
            else (
                "channels are, beside the ground lines,"
                if unknown_which
                else "channels are"
            )
        )
        mend = (
            "turn the array, or number electrodes anew"
            if lines_too
            else "turn the channels' plugs"
        )
        faults.append(
            Fault(
                kind_of(name),  # pyright: ignore
                (),
                name,
                "",
                0.5 if unknown_which else sure,
                f"{what} {name}"
                + (": or the lines are; two corners would tell" if unknown_which else ""),
                f"{mend}; or take the order of --write",
            )
        )
    wrong = {int(c): int(np.flatnonzero(image == electrode[c])[0]) for c in numbers
             if image[c] != electrode[c]}  # fmt: skip
    if not wrong:
        return faults
    for other, order in starts(plane).items():
        off = [order[c] != electrode[c] for c in range(m)]
        explained = sum(off) < 0.3 * len(wrong)
        if other != "as told" and explained and len(wrong) > 0.3 * m:
            wound = "rows" in other and "columns" in other
            faults.append(
                Fault(
                    "mirrored" if wound else "swapped",
                    tuple(wrong),
                    other,
                    "",
                    sure,
                    f"channels are in another order: {other}",
                    "count electrodes as the recording's electrode_xy does, or take the "
                    "order of --write",
                )
            )
            wrong = {c: e for c, e in wrong.items() if order[c] != electrode[c]}
            break
    faults += _reversed_lines(plane, wrong, sure)
    for group in cycles(wrong):
        both = any(set(group) == set(w) for w in wires)
        faults.append(_swapped(group, electrode, both, sure))
    return faults


def _reversed_lines(plane: Plane, wrong: dict[int, int], sure: float) -> list[Fault]:
    """Names rows or columns that are read backwards, and takes them out of `wrong`."""
    grid = lattice(plane)
    if grid is None:
        return []
    index = np.arange(plane.count).reshape(grid)
    faults = []
    for what, table in (("row", index), ("column", index.T)):
        for number, line in enumerate(table):
            back = dict(zip(line.tolist(), line[::-1].tolist()))
            moved = {c: e for c, e in back.items() if c != e}
            if len(moved) < 4 or any(wrong.get(c) != e for c, e in moved.items()):
                continue
            for c in moved:
                del wrong[c]
            faults.append(
                Fault(
                    "mirrored",
                    tuple(int(c) for c in line),
                    f"{what} {number}",
                    "",
                    sure,
                    f"channels of {what} {number} ({line[0]} to {line[-1]}) are reversed",
                    f"turn the plug of {what} {number}, or take the order of --write",
                )
            )
    return faults


def _swapped(group: tuple[int, ...], electrode: Order, both: bool, sure: float) -> Fault:
    pairs = ", ".join(f"channel {c} reads electrode {electrode[c]}" for c in group)
    what = (
        "and their ground lines with them: the electrodes' wires"
        if both
        else ("their ground lines are right")
    )
    names = " and ".join(map(str, group)) if len(group) == 2 else ", ".join(map(str, group))
    return Fault(
        "swapped",
        tuple(sorted(group)),
        {str(c): int(electrode[c]) for c in group},
        "",
        sure,
        f"channels {names} are swapped ({pairs}); {what}",
        f"exchange the wires of {names}, or take the order of --write",
    )


def line_faults(
    plane: Plane,
    asked: np.ndarray,
    ground: np.ndarray,
    share: np.ndarray,
    wires: Sequence[tuple[int, ...]],
) -> list[Fault]:
    """Names shifted, permuted and dead lines; −1 in `ground` means none, −2 unsure.

    `wires`: groups of channels that are swapped.
    """
    m = plane.count
    told = ground >= 0
    faults, expected = [], asked.copy()
    sure = float(min(np.median(share[told]), 0.999)) if told.any() else 0.5
    shift = _shift(asked[told], ground[told], m)
    if shift:
        expected = np.where((asked + shift >= 0) & (asked + shift < m), asked + shift, -1)
        wrapped = (asked + shift) % m
        expected = np.where(ground == wrapped, wrapped, expected)
        faults.append(
            Fault(
                "ground_off_by",
                (),
                shift,
                "electrodes",
                sure,
                f"commanding ground g grounds electrode g {shift:+d}",
                f"command the ground's number {-shift:+d}, or count from "
                f"{'1' if shift < 0 else '0'} in the firmware, or take --write's order",
            )
        )
    elif told.any():
        name, image = best_image(plane, ground[told], np.clip(asked[told], 0, m - 1))
        if name != "identity":
            expected = image[np.clip(asked, 0, m - 1)]
            faults.append(
                Fault(
                    "ground_permuted",
                    (),
                    name,
                    "",
                    sure,
                    f"ground lines are {name}; channels are right",
                    "turn the plugs of the ground lines, or take the order of --write",
                )
            )
    dead = (ground == -1) & (expected != -1)
    for g, s in zip(asked[dead], share[dead]):
        faults.append(
            Fault(
                "ground_stuck",
                (int(g),),
                "off",
                "",
                float(min(s, 0.999)),
                f"ground line {g} switches nothing: the whole sheet rises to the drive",
                f"look at the switch of line {g} and its wire",
            )
        )
    wrong = {int(g): int(e) for g, e in zip(asked, ground) if e >= 0}
    wrong = {g: e for g, e in wrong.items() if e != expected[asked == g][0]}
    # By the number that would ground what this one grounds.
    number = {int(e): int(g) for g, e in zip(asked, expected) if e >= 0}
    groups = cycles({g: number.get(e, e) for g, e in wrong.items()})
    for group in groups:
        if any(set(group) == set(w) for w in wires):
            continue
        pairs = ", ".join(f"line {g} grounds electrode {wrong[g]}" for g in group)
        share_of = min(float(share[asked == g][0]) for g in group)
        closed = {number.get(wrong[g], wrong[g]) for g in group} == set(group)
        if not closed and share_of < _SURE:
            continue
        faults.append(
            Fault(
                "ground_permuted",
                tuple(sorted(group)),
                {str(g): wrong[g] for g in group},
                "",
                float(min(share_of, 0.999)),
                f"ground lines are permuted: {pairs}",
                "exchange these lines' wires, or take the order of --write",
            )
        )
    return faults


def _shift(asked: np.ndarray, ground: np.ndarray, m: int) -> int:
    """Computes the shift of most grounds; 0 where most are right or shifts differ."""
    if len(asked) < _FEW:
        return 0
    steps = (ground - asked + m // 2) % m - m // 2
    values, counts = np.unique(steps, return_counts=True)
    best = int(values[counts.argmax()])
    return best if best and counts.max() >= _MOST * len(asked) else 0


def line_groups(asked: np.ndarray, ground: np.ndarray) -> list[tuple[int, ...]]:
    """Groups lines that are exchanged among themselves."""
    wrong = {int(g): int(e) for g, e in zip(asked, ground) if e >= 0 and e != g}
    return cycles(wrong)
