"""Makes the data of the page's figures: columns of JSON, without NaN."""

from typing import Any

import numpy as np

from tomojax.kernels.flags import Flag


def numbers(values: Any) -> list[float | None]:
    """Returns a list of finite numbers; others become None, which the page leaves out."""
    some = np.asarray(values, float).ravel()
    return [v if ok else None for v, ok in zip(some.tolist(), np.isfinite(some).tolist())]


def pixels(image: np.ndarray) -> dict[str, Any]:
    """Returns an image (nx, ny) row by row upwards, to three digits, and its highest.

    Pixels that are no numbers, as those off the sheet, are None.
    """
    shown = np.asarray(image, float).T
    high = max(float(shown.max(initial=0, where=np.isfinite(shown))), 1e-30)
    return {"pixels": numbers(np.round(shown / high, 3)), "high": 1.0, "top": high}


def contact_columns(
    xy: Any, strength: Any, names: Any = None, unit: tuple[float, str] = (1e6, " µS")
) -> dict[str, list]:
    """Returns places in mm, each with a label of its number and its strength."""
    xy, g = 1e3 * np.asarray(xy, float).reshape(-1, 2), np.asarray(strength, float)
    known = np.isfinite(xy).all(1)
    numbers = np.arange(1, len(xy) + 1) if names is None else np.asarray(names)
    labels = [
        f"{n}: {unit[0] * s:.3g}{unit[1]}" if np.isfinite(s) else f"{n}"
        for n, s in zip(numbers[known].tolist(), g[known])
    ]
    return {"x": xy[known, 0].tolist(), "y": xy[known, 1].tolist(), "label": labels}


def ellipse_columns(xy: Any, covariance: Any) -> dict[str, list]:
    """Returns ellipses of two standard deviations of places, mm."""
    rows = np.column_stack([xy, covariance]).astype(float)
    x, y, xx, yy, both = rows[np.isfinite(rows).all(1)].T
    values, turned = np.linalg.eigh(np.array([[xx, both], [both, yy]]).T)
    h, w = 4e3 * np.sqrt(np.maximum(values, 0)).T
    angle = np.arctan2(turned[:, 1, 1], turned[:, 0, 1])
    told = {"x": 1e3 * x, "y": 1e3 * y, "w": w, "h": h, "angle": angle}
    return {name: column.tolist() for name, column in told.items()}


def flag_lines(flags: int) -> list[tuple[str, str, int]]:
    """Returns each flag's name, its meaning, and how much it takes from a row."""
    some = [flag for flag in Flag if flag.value & flags]
    return [(str(f.name), f.explanation, int(f.level)) for f in some]


def marked_line(
    line: dict[str, list], doubts: dict[str, list], marks: Any, since: float, until: float
) -> tuple[dict[str, dict[str, list]], list[str]]:
    """Returns a time line's sources, and the names of the flags and marks below the line.

    `doubts` are columns of flags; `marks` (s, text) lie between `since` and `until`.
    """
    right = [t > since + 0.7 * (until - since) for t, _ in marks]
    columns = {
        "t": [t for t, _ in marks],
        # Each text is on the side that has room.
        "text": [f"{text} " if r else f" {text}" for r, (_, text) in zip(right, marks)],
        "name": ["marks"] * len(marks),
        "align": ["right" if r else "left" for r in right],
    }
    names = sorted(set(doubts["name"])) + (["marks"] if marks else [])
    return {"line": line, "doubts": doubts, "marks": columns}, names or ["no flags"]


def volt_columns(volts: Any) -> dict[str, list]:
    """Returns voltages, V, by electrode."""
    return {"electrode": list(range(len(volts))), "volts": numbers(volts)}


def chosen_electrode(asked: dict[str, str], electrodes: int) -> int:
    """Returns the electrode that the page asks for, or the first for a wrong number."""
    try:
        number = int(asked.get("electrode", "0"))
    except ValueError:
        return 0
    return number if 0 <= number < electrodes else 0


def spectrum(volts: np.ndarray, rate: float, most: int = 512) -> dict[str, list]:
    """Returns amplitudes, V, over frequencies: the highest in each part of them."""
    window = np.hanning(len(volts))
    found = 2 * np.abs(np.fft.rfft((volts - volts.mean()) * window)) / window.sum()
    f = np.fft.rfftfreq(len(volts), 1 / rate)
    each = max(1, -(-len(f) // most))
    length = len(f) // each * each
    highest = found[:length].reshape(-1, each).max(1)
    middle = f[:length].reshape(-1, each).mean(1)
    return {"f": middle.tolist(), "volts": np.maximum(highest, 1e-9).tolist()}
