"""Checks without JAX: a `ValueError` names the argument, the value and the expectation.

Libraries, and the names of faces, are brought here when they are needed.
"""

import ast
import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import Any

import lazy_loader

# Methods that are no more, and what took their places.
_GONE = {"conductance": "shape", "positive": "source"}

# A side of a sheet, m, that no rig has: this catches millimetres for metres.
LONGEST = 10.0

# Of what came, letters that a line shows: an array's have many lines, a file's text any.
_SHOWN = 200


def require(condition: Any, name: str, got: Any, expected: str) -> None:
    if not condition:
        text = " ".join(str(got).split())
        text = text if len(text) <= _SHOWN else text[:_SHOWN] + "…"
        raise ValueError(f"{name}: got {text}, expected {expected}")


def require_whole(name: str, value: Any, low: int = 1, high: int | None = None) -> None:
    """Requires a whole number from `low` on, up to `high` where that is told."""
    expected = f"{low} or more" if high is None else f"from {low} to {high}"
    fine = isinstance(value, Integral) and low <= int(value) <= (high or math.inf)
    require(fine, name, repr(value), f"a whole number {expected}")


def require_kind(name: str, value: Any, kind: type) -> None:
    """Requires an object of a class of the library's."""
    expected = f"a tomojax {kind.__name__.removeprefix('Abstract')}"
    require(isinstance(value, kind), name, repr(value), expected)


def require_memory(needed: int, name: str) -> None:
    """**Raises:** `ValueError` for bytes that the machine does not have."""
    held = memory()
    text = f"at most {held / 1e9:.0f} GB of memory"
    require(needed < held, name, f"arrays of {needed / 1e9:.0f} GB", text)


def memory() -> int:
    """Returns the machine's memory, bytes."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not on every system
        return 1 << 33


@contextmanager
def naming(name: Any) -> Iterator[None]:
    """Puts a name, a file's, before the text of a `ValueError` that lacks the name."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {str(error).removeprefix(f'{name}: ')}") from None


def one_of(got: str, names: Iterable[str]) -> str:
    """Says which names are expected; of a method that went, what took its place."""
    if got in _GONE:
        return f"{_GONE[got]!r}, which took its place"
    return f"one of {', '.join(names)}"


def library(name: str, extra: str) -> Any:
    """Imports a library that an extra of tomojax brings.

    **Raises:** `ModuleNotFoundError` that says which extra.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        root = name.partition(".")[0]
        if str(error.name).partition(".")[0] != root:
            raise
        raise ModuleNotFoundError(not_installed(root, extra), name=root) from None


def attach(name: str, file: str) -> tuple[Callable, Callable, list[str]]:
    """Returns a face's `__getattr__`, `__dir__` and `__all__`, all by its stub."""
    getter, lister, _ = lazy_loader.attach_stub(name, file)
    public = ast.parse(Path(file).with_suffix(".pyi").read_text()).body[-1]
    assert isinstance(public, ast.Assign)
    return getter, lister, ast.literal_eval(public.value)


def require_library(name: str, extra: str) -> None:
    """**Raises:** `ValueError` unless a library that an extra brings is installed."""
    if find_spec(name) is None:
        raise ValueError(not_installed(name, extra))


def not_installed(name: str, extra: str) -> str:
    """Says which extra of tomojax brings a missing library."""
    return f"{name} is not installed; pip install 'tomojax[{extra}]' brings it"


def check_electrodes(electrode_xy: Any, size: Any, electrode_diameter: Any) -> None:
    """Refuses discs that overlap or leave the sheet. **Raises:** `ValueError`."""
    import numpy as np  # help and versions are told without

    xy, size, diameter = (
        np.asarray(a, np.float64) for a in (electrode_xy, size, electrode_diameter)
    )
    slack = 1e-5 * diameter  # an electrode may touch the edge to rounding
    low, high = (xy - diameter / 2).min(1), (xy + diameter / 2 - size).max(1)
    outside = np.flatnonzero((low < -slack) | (high > slack))
    require(
        not outside.size,
        "electrode_xy",
        f"electrodes {outside[:5].tolist()} beyond the sheet's edge",
        f"discs of {diameter:g} m inside {size.tolist()} m",
    )
    check_apart(xy, diameter, slack)


def check_apart(places: Any, diameter: Any, slack: Any) -> None:
    """Refuses electrodes that overlap by more than `slack`. **Raises:** `ValueError`."""
    import numpy as np

    apart = np.sqrt(((places[:, None] - places) ** 2).sum(-1))
    apart[np.diag_indices_from(apart)] = np.inf
    one, other = np.unravel_index(apart.argmin(), apart.shape)
    require(
        apart.min() > diameter - slack,
        "electrode_xy",
        f"electrodes {one} and {other} {apart.min():.3g} m apart",
        f"more than their diameter, {diameter:g} m",
    )
