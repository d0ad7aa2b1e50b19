"""Every public function and class has an example, and examples do what they say."""

import inspect
from collections.abc import Iterator
from typing import Any

import docstrings
import pytest

import tomojax as tx
import tomojax.ert
import tomojax.events
import tomojax.exports
import tomojax.plots

ROOMS = [name for name in tx.__all__ if inspect.ismodule(getattr(tx, name))]
# Rooms that are imported by their own names.
BESIDE = [tomojax.ert, tomojax.events, tomojax.exports, tomojax.plots]


@pytest.mark.parametrize("example", docstrings.share(""))
def test_example(example, tmp_path) -> None:
    docstrings.run(example, tmp_path)


def public() -> Iterator[tuple[str, Any]]:
    """Functions and classes by the names that users have them under."""
    for room in (tx, *(getattr(tx, name) for name in ROOMS), *BESIDE):
        for name in room.__all__:
            thing = getattr(room, name)
            if inspect.isclass(thing) or inspect.isroutine(inspect.unwrap(thing)):
                yield f"{room.__name__}.{name}", thing


def test_every_public_name_has_an_example() -> None:
    texts = {each.text for each in docstrings.examples()}
    named = dict(public())
    without = [
        name
        for name, thing in named.items()
        if "**Example:**" not in (inspect.getdoc(thing) or "")
        or inspect.getdoc(thing) not in texts
    ]
    assert len(named) > 130 and not without


def test_every_example_runs_in_one_file() -> None:
    shared = [one.values[0] for name in docstrings.SHARES for one in docstrings.share(name)]
    assert sorted(shared) == sorted(docstrings.examples())
    names = {each.name for each in shared}
    assert docstrings.LONG < names
