"""Writes and draws what `check` has found."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tomojax._pictures import (
    BLACK,
    BLUE,
    GREEN,
    lay_sheet,
    ORANGE,
    PURPLE,
    VALUE,
    VERMILION,
)
from tomojax._whole import write_text
from tomojax.bringup._fault import Checked, Fault

# How faults are drawn at their electrodes: marker and colour.
_MARKS = {
    "dead": ("x", VERMILION),
    "stuck": ("s", VERMILION),
    "shorted": ("p", VERMILION),
    "gain": ("^", ORANGE),
    "noise": ("*", ORANGE),
    "hum": ("H", ORANGE),
    "settling": ("v", ORANGE),
    "ground_stuck": ("P", PURPLE),
    "leak": ("X", PURPLE),
    "ground_permuted": ("D", PURPLE),
    "swapped": ("o", BLUE),
    "mirrored": ("8", BLUE),
    "misplaced": ("d", GREEN),
    "tear": ("h", BLACK),
}

# Numbers of channels in a title or a legend, at most.
_SHOWN = 6


def text(checked: Checked) -> str:
    """Writes the faults in lines, each with certainty and mend, and the parts not judged.

    **Example:**

    >>> import tomojax as tx
    >>> tx.bringup.text.__name__
    'text'
    """
    count = len(checked.faults)
    figures = checked.figures
    lines = [
        f"{figures['slots_touched']:.0f} slots with a contact, "
        f"{figures['slots_quiet']:.0f} without; contacts fit to "
        f"{figures['residual_percent']:.2f} % of the voltages' span"
    ]
    if "noise_V" in figures:
        lines.append(f"noise {1e3 * figures['noise_V']:.2f} mV rms")
    if "drive_V" in figures:
        lines.append(f"drive {figures['drive_V']:.2f} V ± {figures['drive_known_V']:.2f} V")
    if "sheet_factor" in figures:
        lines.append(
            f"sheet resistance {figures['sheet_factor']:.2f} times what is told, ± "
            f"{figures['sheet_factor_known']:.2f}, if the ground path is as told"
        )
    lines.append("no fault found" if not count else f"{count} fault{'s'[: count > 1]}:")
    for fault in checked.faults:
        sure = f"{100 * fault.certainty:.1f} % sure"
        lines += [f"- {fault.kind}: {fault.text} ({sure})", f"  mend: {fault.mend}"]
    if checked.unjudged:
        lines.append("not judged:")
        lines += [f"- {what}: {why}" for what, why in checked.unjudged.items()]
    return "\n".join(lines)


def summary(checked: Checked) -> dict[str, Any]:
    """Collects the values that `--json` writes: `faults`, `unjudged`, order, figures.

    **Example:**

    >>> import tomojax as tx
    >>> tx.bringup.summary.__name__
    'summary'
    """
    faults = [f._asdict() | {"channels": list(f.channels)} for f in checked.faults]
    return {
        "faults": faults,
        "unjudged": dict(checked.unjudged),
        "channels": checked.channels.tolist(),
        "grounds": checked.grounds.tolist(),
        "rows": faults,
        "summary": {name: float(value) for name, value in checked.figures.items()},
    }


def write_order(checked: Checked, path: Path | str) -> None:
    """Writes the corrected order for `--config` of `live` and `record`, as TOML.

    **Example:**

    >>> import tomojax as tx
    >>> tx.bringup.write_order.__name__
    'write_order'
    """
    lines = [
        "# The order that `tomojax check` found: --config of `tomojax live` and `record`.",
        "# The electrode that each channel reads, and that each ground line switches",
        "# (-1: none).",
        f"channels = {checked.channels.tolist()}",
        f"grounds = {checked.grounds.tolist()}",
    ]
    write_text(path, "\n".join(lines) + "\n")


def picture(checked: Checked) -> Any:
    """Draws the sheet with its electrodes, contacts, and the faults at their places.

    **Example:**

    >>> import tomojax as tx
    >>> tx.bringup.picture.__name__
    'picture'
    """
    from matplotlib.figure import Figure

    plane, swing = checked.seen
    figure = Figure(figsize=(7.6, 6.6), layout="compressed")
    axes = figure.subplots()
    xy, radius = 1e3 * plane.xy, 500 * plane.diameter
    outline = plane.outline and plane.outline.lines(plane.size)
    lay_sheet(axes, plane.size, plane.xy, plane.diameter, outline=outline)
    contacts = 1e3 * checked.contacts.T
    axes.plot(*contacts, ".", color="0.75", ms=3, zorder=1, label="contacts")
    look = {"cmap": VALUE, "edgecolors": "0.3", "lw": 0.5, "zorder": 2}
    drawn = axes.scatter(*xy.T, c=swing, s=90, **look)
    figure.colorbar(drawn, label="median voltage while something touches, V")
    number = {"ha": "center", "va": "bottom", "fontsize": 6}
    for channel, (x, y) in zip(np.argsort(checked.channels), xy):
        axes.annotate(str(channel), (x, y), (x, y + 1.3 * radius), **number)
    for fault in checked.faults:
        if fault.channels and fault.kind in _MARKS:
            _draw(axes, checked, fault, xy)
    whole = [f.text for f in checked.faults if not f.channels]
    axes.set_title("Electrodes, numbered by the channels that read them")
    handles, names = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, names, loc="outside lower center", fontsize=8, ncols=2)
    if whole or not checked.faults:
        figure.suptitle("; ".join(whole) or "no fault found", fontsize=9, wrap=True)
    return figure


def _draw(axes: Any, checked: Checked, fault: Fault, xy: Float[np.ndarray, "M 2"]) -> None:
    marker, colour = _MARKS[fault.kind]
    numbers = np.array(fault.channels)
    at = checked.channels[numbers]
    if fault.kind.startswith("ground"):  # lines are named by themselves
        grounds = checked.grounds[numbers]
        at = np.where(grounds >= 0, grounds, numbers)
    some = ", ".join(map(str, fault.channels[:_SHOWN]))
    label = f"{fault.kind} {some}" + (", …" if len(numbers) > _SHOWN else "")
    look = {"color": colour, "ms": 13, "mfc": "none", "mew": 2, "zorder": 4}
    axes.plot(*xy[at].T, marker, label=label, **look)
    if fault.kind == "misplaced" and isinstance(fault.value, dict):
        by, arrow = [fault.value["x_mm"], fault.value["y_mm"]], {"arrowstyle": "->"}
        axes.annotate("", xy[at[0]] + by, xy[at[0]], arrowprops={**arrow, "color": colour})
    if fault.kind == "swapped" and len(at) == 2:
        axes.plot(*xy[at].T, "-", color=colour, lw=1, zorder=3)
