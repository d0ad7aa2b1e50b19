"""Examples of docstrings, as users run them; for the files of tests/examples.

What xdist hands to a worker is a file: one file with all examples kept one worker busy
after the others had ended. Examples of a room have sensor and shapes in common.
"""

import ast
import contextlib
import doctest
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import pytest

ROOT = Path(__file__).parents[1]
SOURCES = ("tomojax", "kernels", "hardware")
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# The folders whose examples a file of tests/examples has; `test_all` has all others.
SHARES = {
    "": (),
    "calibration": ("tomojax/bringup", "tomojax/calibration"),
    "design": ("tomojax/design",),
    "results": ("tomojax/exports", "tomojax/results", "tomojax/step"),
}
# Five seconds to half a minute each.
LONG = {
    "background",
    "calibrate_recording",
    "calibrated_recording",
    "changes",
    "choose",
    "compare_patterns",
    "descend_sets",
    "design_electrodes",
    "ElectrodeDesign",
    "estimate",
    "HeldCalibration",
    "image_spread",
    "ImageShape",
    "learn",
    "nominal",
    "PlaceDesigns",
    "PressInformation",
    "Ready",
    "sensitivities",
    "shape_objective",
    "ShapeInformation",
    "tune",
}
_DOCUMENTED = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


class Example(NamedTuple):
    """A docstring with an example, by its file and the name of what it describes."""

    path: str
    name: str
    text: str


@cache
def examples() -> tuple[Example, ...]:
    """Returns every docstring of the package that has a doctest."""
    paths = (path for folder in SOURCES for path in sorted((ROOT / folder).rglob("*.py")))
    return tuple(example for path in paths for example in _in(path))


def _in(path: Path) -> Iterator[Example]:
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED | ast.Module):
            text = ast.get_docstring(node) or ""
            if ">>>" in text:
                name = getattr(node, "name", "")
                yield Example(str(path.relative_to(ROOT)), name, text)


def share(name: str) -> list[Any]:
    """Returns the examples of one file of tests, as its parameters."""
    own = SHARES[name]
    others = tuple(one for folders in SHARES.values() for one in folders)

    def mine(path: str) -> bool:
        among = own or others
        inside = any(path.startswith(f"{folder}/") for folder in among)
        return inside == bool(own)

    return [
        pytest.param(
            each,
            id=f"{each.path}-{each.name}",
            marks=[pytest.mark.long] if each.name in LONG else [],
        )
        for each in examples()
        if mine(each.path)
    ]


def run(each: Example, folder: Path) -> None:
    """Runs an example with JAX's own settings, in a folder of its own."""
    parsed = doctest.DocTestParser().get_doctest(each.text, {}, each.name, each.path, None)
    said: list[str] = []
    with (
        contextlib.chdir(folder),
        jax.enable_x64(False),
        jax.numpy_dtype_promotion("standard"),
    ):
        done = doctest.DocTestRunner(optionflags=OPTIONS).run(parsed, out=said.append)
    assert not done.failed, "".join(said)
