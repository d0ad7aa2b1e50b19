"""Compiled functions whose programs are kept between processes.

JAX's own cache keeps what is compiled, under a key that tracing and lowering make first:
three seconds for each program of `points`. Here the lowered program is kept as well.
"""

import functools
import hashlib
import importlib.util
import os
import pickle
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.export
import jax.numpy as jnp
import numpy as np

# The environment variable that names the folder; without it nothing is kept.
FOLDER = "TOMOJAX_PROGRAMS"

# JAX writes programs with this package.
_WRITES = importlib.util.find_spec("flatbuffers") is not None

# XLA's CPU compiler takes half the time with these. What it makes runs as fast within 8 %,
# but `linear` 10 to 15 % slower: thousands of small operations gain little from the rest.
_QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}


def kept(function: Callable) -> Callable:
    """Compiles a function of pytrees, as `eqx.filter_jit` does, and keeps its programs.

    A program is told by the function's name, the package's source, and the arguments:
    their structure, the shapes and types of arrays, the values of all else. Where it cannot
    be kept, it is compiled all the same.
    """
    part = eqx.filter_jit(function)
    asked = lambda: {"compiler_options": options()}  # noqa: E731
    plain = functools.cache(lambda: eqx.filter_jit(function, **asked()))  # pyright: ignore
    loaded: dict[Any, Callable] = {}
    lock = threading.Lock()

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        folder = os.environ.get(FOLDER)
        if not jax.core.trace_ctx.is_top_level():
            return part(*args)  # of another program, which has the compiler's options
        # A program that is kept is of one device.
        if not folder or not _WRITES or jax.device_count() > 1:
            return plain()(*args)
        arrays, static = eqx.partition(args, _is_array)
        flat, tree = jax.tree.flatten(arrays)
        shapes = tuple((a.shape, a.dtype) for a in flat)
        still = jax.tree.flatten(static)
        # What `jax.enable_x64` says makes other constants.
        wide = jax.config.jax_enable_x64  # pyright: ignore
        key = tree, still[1], tuple(map(repr, still[0])), shapes, wide
        with lock:
            if key not in loaded:
                path = Path(folder) / f"{_named(function, key)}.program"
                loaded[key] = _loaded(function, args, flat, path)
        return loaded[key](*flat)

    call.loaded = loaded  # pyright: ignore
    return call


@functools.cache
def options() -> dict[str, Any]:
    """The compiler's options; none on a GPU, and none where XLA does not know them."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x, compiler_options=_QUICK).lower(np.zeros(1)).compile()
    except Exception:  # JAX says of no class of errors that it is this one
        return {}
    return _QUICK


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def _named(function: Callable, key: Any) -> str:
    told = "\n".join([_source(), function.__module__, function.__qualname__, repr(key)])
    return f"{function.__name__.strip('_')}-{hashlib.sha256(told.encode()).hexdigest()}"


@functools.cache
def _source() -> str:
    """A digest of the package's files: a program is of the code that made it."""
    here = Path(__file__).parent
    # In a checkout `kernels/` lies beside this folder.
    roots = [here, here.parent / "kernels"]
    digest = hashlib.sha256()
    for path in sorted(path for root in roots for path in root.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _loaded(function: Callable, args: tuple, flat: list, path: Path) -> Callable:
    """The program of a file; made, and written, where there is none that can be read."""
    with suppress(Exception):  # a file that was cut short, or is of another JAX
        program, template = pickle.loads(path.read_bytes())
        _prepare_lapack()
        return _called(jax.export.deserialize(bytearray(program)), template)
    dynamic, static = eqx.partition(args, _is_array)
    tree = jax.tree.structure(dynamic)
    template: Any = None

    def flattened(*arrays: Any) -> list:
        nonlocal template
        out = function(*eqx.combine(jax.tree.unflatten(tree, arrays), static))
        leaves, structure = jax.tree.flatten(out)
        template = jax.tree.unflatten(structure, range(len(leaves)))
        return leaves

    flattened.__name__ = function.__name__
    exported = jax.export.export(jax.jit(flattened))(*flat)
    with suppress(OSError):
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(pickle.dumps((bytes(exported.serialize()), template)))
        part.replace(path)
    return _called(exported, template)


def _called(exported: Any, template: Any) -> Callable:
    structure = jax.tree.structure(template)
    name = exported.fun_name

    def call(*flat: Any) -> list:
        return exported.call(*flat)

    call.__name__ = name  # JAX tells what it compiles by that
    compiled = jax.jit(call, compiler_options=options())
    return lambda *flat: jax.tree.unflatten(structure, compiled(*flat))


@functools.cache
def _prepare_lapack() -> None:
    """Makes JAX find LAPACK's functions, which a program that is loaded just calls."""
    jax.jit(jnp.linalg.cholesky).lower(np.eye(2, dtype=np.float32))
