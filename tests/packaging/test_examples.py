"""Every public function and class has an example, and examples do what they say."""

import doctest
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import pytest

import tomojax as tx
import tomojax.events
import tomojax.exports
import tomojax.plots

ROOT = Path(__file__).parents[2]
ROOMS = [name for name in tx.__all__ if inspect.ismodule(getattr(tx, name))]
# Rooms that are imported by their own names.
BESIDE = [tomojax.events, tomojax.exports, tomojax.plots]
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public() -> Iterator[tuple[str, Any]]:
    """Functions and classes by the names that users have them under."""
    for room in (tx, *(getattr(tx, name) for name in ROOMS), *BESIDE):
        for name in room.__all__:
            thing = getattr(room, name)
            if inspect.isclass(thing) or inspect.isroutine(inspect.unwrap(thing)):
                yield f"{room.__name__}.{name}", thing


EXAMPLES = {id(thing): (name, thing) for name, thing in public()}


@pytest.mark.parametrize(
    "name, thing", [pytest.param(*each, id=each[0]) for each in EXAMPLES.values()]
)
def test_example(name, thing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(thing) or ""
    assert "**Example:**" in text
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples
    said: list[str] = []
    # As a user runs it: JAX's own settings.
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"):
        done = doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=said.append)
    assert not done.failed, "".join(said)
