"""Tells a process that was forked from JAX's threads that JAX would wait for ever in it."""

import os
import sys

_TOLD = (
    "this process was forked from one that runs JAX, whose threads it lacks: JAX would "
    'wait for ever. Start it by multiprocessing.get_context("spawn")'
)

_forked = False


def runs_jax() -> bool:
    """Tells whether this process, or the one that it was forked from, has begun JAX."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bool(getattr(bridge, "_backends", None))


def _mark() -> None:
    global _forked
    _forked = runs_jax()


def refuse_fork() -> None:
    """Raises `RuntimeError` in a process that was forked from one that runs JAX."""
    if _forked:
        raise RuntimeError(_TOLD)


def refuse_child() -> None:
    """Raises as `refuse_fork` in a child of `multiprocessing` that imports the package."""
    multiprocessing = sys.modules.get("multiprocessing")
    if multiprocessing is None or multiprocessing.parent_process() is None:
        return
    how = getattr(multiprocessing.current_process(), "_start_method", None)
    how = how or multiprocessing.get_start_method(allow_none=True)
    if how == "fork" and runs_jax():
        raise RuntimeError(_TOLD)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_mark)
