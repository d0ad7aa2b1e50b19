"""Turns orders of channels and lines into named faults of wiring."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Integer

from tomojax.bringup._fault import Fault, Kind, SUREST
from tomojax.bringup._wiring import Lines
from tomojax.bringup.sheet._plane import lattice, Plane, starts, symmetries

# Part of the channels, or of the judged lines, that a mirror or a shift must explain.
_MOST = 0.6

# Slots that agree, of a line that is exchanged with none.
_SURE = 0.85

# Lines that have to be judged for a shift.
_FEW = 3

_OR_WRITE = "or take the order of --write"

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


def whole_fault(name: str, lines_too: bool, unknown_which: bool, sure: float) -> Fault:
    """Names an array, or channels, that a symmetry other than "identity" explains.

    `lines_too`: ground lines are mirrored with the channels; `unknown_which`: nobody knows
    whether channels or lines are.
    """
    what, mend = "channels are", "turn the channels' plugs"
    if lines_too:
        what = "the array, channels and ground lines alike, is"
        mend = "turn the array, or number electrodes anew"
    elif unknown_which:
        what = "channels are, beside the ground lines,"
    doubt = ": or the lines are; two corners would tell" if unknown_which else ""
    kind: Kind = "turned" if name.startswith("turned") else "mirrored"
    sure = 0.5 if unknown_which else sure
    return Fault(kind, (), name, "", sure, f"{what} {name}{doubt}", f"{mend}; {_OR_WRITE}")


def channel_faults(
    plane: Plane,
    electrode: Order,
    image: Order,
    sure: float,
    wires: Sequence[tuple[int, ...]],
) -> list[Fault]:
    """Names channels in another order than `image`; channel c reads `electrode[c]`.

    `wires`: groups whose ground lines are swapped as well.
    """
    faults = []
    back = np.argsort(image)
    wrong = {int(c): int(back[electrode[c]]) for c in np.flatnonzero(image != electrode)}
    for other, order in starts(plane).items():
        off = int((order != electrode).sum())
        many = len(wrong) > 0.3 * len(electrode)
        if other != "as told" and many and off < 0.3 * len(wrong):
            wound = "rows" in other and "columns" in other
            kind: Kind = "mirrored" if wound else "swapped"
            text = f"channels are in another order: {other}"
            mend = f"count electrodes as the recording's electrode_xy does, {_OR_WRITE}"
            faults.append(Fault(kind, tuple(wrong), other, "", sure, text, mend))
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
        for number, line in enumerate(table.tolist()):
            moved = {c: e for c, e in zip(line, line[::-1]) if c != e}
            if len(moved) < 4 or any(wrong.get(c) != e for c, e in moved.items()):
                continue
            for c in moved:
                del wrong[c]
            name, ends = f"{what} {number}", f"{line[0]} to {line[-1]}"
            text = f"channels of {name} ({ends}) are reversed"
            mend = f"turn the plug of {name}, {_OR_WRITE}"
            faults.append(Fault("mirrored", tuple(line), name, "", sure, text, mend))
    return faults


def _swapped(group: tuple[int, ...], electrode: Order, both: bool, sure: float) -> Fault:
    pairs = ", ".join(f"channel {c} reads electrode {electrode[c]}" for c in group)
    what = "their ground lines are right"
    if both:
        what = "and their ground lines with them: the electrodes' wires"
    names = (" and " if len(group) == 2 else ", ").join(map(str, group))
    reads = {str(c): int(electrode[c]) for c in group}
    text = f"channels {names} are swapped ({pairs}); {what}"
    mend = f"exchange the wires of {names}, {_OR_WRITE}"
    return Fault("swapped", tuple(sorted(group)), reads, "", sure, text, mend)


def line_faults(
    plane: Plane, lines: Lines, wires: Sequence[tuple[int, ...]]
) -> list[Fault]:
    """Names shifted, permuted and dead lines; `wires`: groups of channels swapped."""
    asked, ground, share, m = lines.asked, lines.ground, lines.share, plane.count
    told, inside = ground >= 0, np.clip(asked, 0, m - 1)
    faults, expected = [], asked.copy()
    sure = float(min(np.median(share[told]), SUREST)) if told.any() else 0.5
    shift = _shift(asked[told], ground[told], m)
    name, image = "identity", inside
    if told.any() and not shift:
        name, image = best_image(plane, ground[told], inside[told])
    if shift:
        expected = np.where((asked + shift >= 0) & (asked + shift < m), asked + shift, -1)
        wrapped = (asked + shift) % m
        expected = np.where(ground == wrapped, wrapped, expected)
        text = f"commanding ground g grounds electrode g {shift:+d}"
        mend = (
            f"command the ground's number {-shift:+d}, or count from "
            f"{'1' if shift < 0 else '0'} in the firmware, or take --write's order"
        )
        faults.append(Fault("ground_off_by", (), shift, "electrodes", sure, text, mend))
    elif name != "identity":
        expected = image[inside]
        text = f"ground lines are {name}; channels are right"
        mend = f"turn the plugs of the ground lines, {_OR_WRITE}"
        faults.append(Fault("ground_permuted", (), name, "", sure, text, mend))
    off = (ground == -1) & (expected != -1)
    for g, part in zip(asked[off].tolist(), share[off].tolist()):
        text = f"ground line {g} switches nothing: the whole sheet rises to the drive"
        mend, sure = f"look at the switch of line {g} and its wire", min(part, SUREST)
        faults.append(Fault("ground_stuck", (g,), "off", "", sure, text, mend))
    return faults + _permuted_lines(lines, expected, wires)


def _permuted_lines(
    lines: Lines, expected: np.ndarray, wires: Sequence[tuple[int, ...]]
) -> list[Fault]:
    """Names lines that ground other electrodes than `expected`."""
    grounded = {int(g): int(e) for g, e in zip(lines.asked, lines.ground)}
    share = {int(g): float(s) for g, s in zip(lines.asked, lines.share)}
    # By the number that would ground what this one grounds.
    number = {int(e): int(g) for g, e in zip(lines.asked, expected) if e >= 0}
    off = (lines.ground >= 0) & (lines.ground != expected)
    wrong = {int(g): number.get(grounded[g], grounded[g]) for g in lines.asked[off]}
    faults = []
    for group in cycles(wrong):
        sure = min(share[g] for g in group)
        closed = {wrong[g] for g in group} == set(group)
        if any(set(group) == set(w) for w in wires) or not closed and sure < _SURE:
            continue
        pairs = ", ".join(f"line {g} grounds electrode {grounded[g]}" for g in group)
        text, sure = f"ground lines are permuted: {pairs}", min(sure, SUREST)
        mend, lines_at = f"exchange these lines' wires, {_OR_WRITE}", tuple(sorted(group))
        value = {str(g): grounded[g] for g in group}
        faults.append(Fault("ground_permuted", lines_at, value, "", sure, text, mend))
    return faults


def _shift(asked: np.ndarray, ground: np.ndarray, m: int) -> int:
    """Computes the shift of most grounds; 0 where most are right or shifts differ."""
    if len(asked) < _FEW:
        return 0
    steps = (ground - asked + m // 2) % m - m // 2
    values, counts = np.unique(steps, return_counts=True)
    best = int(values[counts.argmax()])
    return best if best and counts.max() >= _MOST * len(asked) else 0


def line_groups(lines: Lines) -> list[tuple[int, ...]]:
    """Groups lines that are exchanged among themselves."""
    off = (lines.ground >= 0) & (lines.ground != lines.asked)
    return cycles(dict(zip(lines.asked[off].tolist(), lines.ground[off].tolist())))
