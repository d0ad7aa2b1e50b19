"""How objects print: in a few lines, whatever they hold. Loads no JAX."""

import math
from collections.abc import Iterable
from html import escape
from typing import Any

# Numbers of an array that are printed.
_FEW = 8


def shown(value: Any, unit: str = "", factor: float = 1.0) -> str:
    """Returns a number or a few as text, and of a longer array its type and shape.

    `factor` takes the numbers to the `unit`.
    """
    shape = getattr(value, "shape", None)
    if shape is None:
        plain = isinstance(value, float) or (factor != 1 and isinstance(value, int))
        text = _nested(float(factor * value)) if plain else repr(value)
        return f"{text} {unit}".rstrip()
    if math.prod(shape) > _FEW:
        return f"{value.dtype}{list(shape)}" + (f" in {unit}" if unit else "")
    numbers = numbers_of(value)
    if numbers is None:
        return f"{value.dtype}{list(shape)}"
    return f"{_nested((factor * numbers).tolist())} {unit}".rstrip()


def numbers_of(value: Any) -> Any:
    """Returns a NumPy array, or None of a trace's placeholder and what else has none."""
    import numpy as np

    try:
        numbers = np.asarray(value)
    except Exception:  # a trace's placeholder
        return None
    return numbers if numbers.dtype.kind in "biuf" else None


def named(thing: Any, **fields: str) -> str:
    """Returns the name of a thing's class with its fields, as far as they fit."""
    return f"{type(thing).__name__}({', '.join(f'{k}={v}' for k, v in fields.items())})"


def tuple_shown(thing: Any, **units: tuple[str, float]) -> str:
    """Returns a named tuple as text; `units`: of some fields the unit and a factor."""
    told = {}
    for name, value in thing._asdict().items():
        unit, factor = units.get(name, ("", 1.0))
        told[name] = shown(value, unit, factor)
    return named(thing, **told)


def _nested(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_nested, value))}]"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def html_table(
    rows: Iterable[Iterable[Any]], head: Iterable[str] = (), title: str = ""
) -> str:
    """Returns a table for a notebook; texts are escaped."""
    cell = lambda tag, value: f"<{tag}>{escape(str(value))}</{tag}>"  # noqa: E731
    lines = [f"<caption>{escape(title)}</caption>"] if title else []
    names = "".join(cell("th", name) for name in head)
    lines += [f"<tr>{names}</tr>"] if names else []
    lines += [f"<tr>{''.join(cell('td', v) for v in row)}</tr>" for row in rows]
    return f"<table>{''.join(lines)}</table>"
