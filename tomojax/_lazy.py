"""Faces of rooms whose names are imported when they are first used (SPEC 1)."""

import ast
from collections.abc import Callable
from pathlib import Path

import lazy_loader


def attach(name: str, file: str) -> tuple[Callable, Callable, list[str]]:
    """Returns a face's `__getattr__`, `__dir__` and `__all__`, all by its stub."""
    getter, lister, _ = lazy_loader.attach_stub(name, file)
    public = ast.parse(Path(file).with_suffix(".pyi").read_text()).body[-1]
    assert isinstance(public, ast.Assign)
    return getter, lister, ast.literal_eval(public.value)
