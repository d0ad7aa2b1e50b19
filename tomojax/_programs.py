"""Compiled functions whose programs are kept between processes.

JAX's own cache keeps compiled programs, under a key from tracing and lowering. This file
keeps lowered programs too. A `reconstruct --method points` of the demo's first 0.1 s takes
8 s of a processor's time with both, 22 s with JAX's cache alone, and 46 s with none.
"""

import functools
import hashlib
import importlib.util
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args, NamedTuple

import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from tomojax._forked import refuse_fork
from tomojax._whole import ours

# The environment variable that names the folder; without it nothing is kept, nor in a
# folder that others can write: a program that is read is run.
FOLDER = "TOMOJAX_PROGRAMS"

# JAX writes programs with this package.
_WRITES = importlib.util.find_spec("flatbuffers") is not None

# XLA's CPU compiler takes half the time with these. What it makes runs as fast within 8 %,
# but `linear` 10 to 15 % slower: thousands of small operations gain little from the rest.
_QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}


class Kept:
    """A function of pytrees, compiled as `eqx.filter_jit` does; keeps its programs.

    A key names a program: the function's name, the package's source and the arguments. The
    key holds the arguments' structure, the arrays' shapes and types, and all other values.
    A program that cannot be kept is compiled all the same. Compilers run beside the caller:
    `begin` lets several programs compile side by side.

    A file holds what `jax.export` writes. The function's annotation names what it returns:
    arrays, and tuples of arrays with and without names.
    """

    def __init__(self, function: Callable):
        functools.update_wrapper(self, function)
        _register(function.__annotations__.get("return"))
        self._function, self._inside = function, eqx.filter_jit(function)
        # On several devices arrays come in parts, which a program that is kept does not.
        self._shared = functools.cache(lambda: _with_options(function))
        self._programs: dict[Any, _Program] = {}
        self._lock = threading.Lock()
        _KEPT.append(self)

    def __call__(self, *args: Any) -> Any:
        refuse_fork()
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(args)):
            return self._inside(*args)  # within another program
        if jax.device_count() > 1:
            return self._shared()(*args)
        program, flat = self._program(args)
        return program(flat)

    def begin(self, *args: Any) -> Any:
        """Traces, and lets a thread compile; returns the results' shapes and types."""
        if jax.device_count() > 1:
            return eqx.filter_eval_shape(self._function, *args)
        return self._program(args)[0].shapes

    def forget(self) -> None:
        """Drops the programs that this process holds."""
        self._programs.clear()

    def _program(self, args: tuple) -> "tuple[_Program, list]":
        arrays, static = eqx.partition(args, _is_array)
        flat, tree = jax.tree.flatten(arrays)
        shapes = tuple((a.shape, np.dtype(a.dtype)) for a in flat)
        leaves, still = jax.tree.flatten(static)
        key = tree, still, tuple((type(a), a) for a in leaves), shapes, _wide()
        with self._lock:
            if key not in self._programs:
                folder, path = os.environ.get(FOLDER), None
                if folder and _WRITES and ours(folder):
                    told = tree, still, tuple(map(repr, leaves)), shapes, _wide()
                    path = Path(folder) / f"{_named(self._function, told)}.program"
                self._programs[key] = _made(self._function, args, flat, path)
        return self._programs[key], flat


_KEPT: list[Kept] = []


def kept(function: Callable) -> Kept:
    """Wraps a function in `Kept`."""
    return Kept(function)


def forget() -> None:
    """Drops all kept programs of this process; `jax.clear_caches` drops JAX's own."""
    for one in _KEPT:
        one.forget()


@functools.cache
def _register(kind: Any) -> None:
    """Lets JAX write and read the named tuples that a type is made of."""
    parts = get_args(kind)
    if isinstance(kind, type) and hasattr(kind, "_fields"):
        name = f"{kind.__module__}.{kind.__qualname__}"
        with suppress(ValueError):  # another function returns it, too
            jax.export.register_namedtuple_serialization(kind, serialized_name=name)
        parts = kind.__annotations__.values()
    for part in parts:
        _register(part)


def _wide() -> bool:
    """Tells what `jax.enable_x64` says in this thread; constants differ by it."""
    return jax.config.jax_enable_x64  # pyright: ignore


class _Program(NamedTuple):
    """A program that is compiled, or will be; and the shapes of what it returns."""

    compiled: Future
    shapes: Any

    def __call__(self, flat: list) -> Any:
        try:
            return self.compiled.result()(*flat)
        except KeyboardInterrupt:
            _stop_compiling()
            raise


@functools.cache
def _compilers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), "compiling")


def _stop_compiling() -> None:
    """Drops programs that no compiler has begun: an ending process would wait for them."""
    _compilers().shutdown(wait=False, cancel_futures=True)
    _compilers.cache_clear()
    forget()


def _with_options(function: Callable) -> Callable:
    return eqx.filter_jit(function, **{"compiler_options": options()})  # pyright: ignore


@functools.cache
def options() -> dict[str, Any]:
    """Returns the compiler's options; none on a GPU or where XLA does not know them.

    A user who has set XLA's level of optimisation has decided.
    """
    decided = "xla_backend_optimization_level" in os.environ.get("XLA_FLAGS", "")
    if decided or jax.default_backend() != "cpu":
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
    """Returns a digest of the package's files: a program belongs to its source code."""
    here = Path(__file__).parent
    # In a checkout `kernels/` lies beside this folder.
    roots = [here, here.parent / "kernels"]
    digest = hashlib.sha256()
    for path in sorted(path for root in roots for path in root.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _made(function: Callable, args: tuple, flat: list, path: Path | None) -> _Program:
    """Reads the program of a file; traces and writes one where no file can be read."""
    if path is not None:
        with suppress(Exception):  # a file that was cut short, or is of another JAX
            exported = jax.export.deserialize(bytearray(path.read_bytes()))
            _prepare_lapack()
            return _of_exported(exported, flat)
    arrays, static = eqx.partition(args, _is_array)
    tree = jax.tree.structure(arrays)

    def flattened(*flat: Any) -> Any:
        return function(*eqx.combine(jax.tree.unflatten(tree, flat), static))

    flattened.__name__ = function.__name__
    if path is None:
        traced = jax.jit(flattened, compiler_options=options()).trace(*flat)
        return _later(traced.lower, traced.out_info)
    exported = jax.export.export(jax.jit(flattened))(*flat)
    with suppress(OSError, ValueError):  # a full disk, or a class that is not registered
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(exported.serialize())
        part.replace(path)
    return _of_exported(exported, flat)


def _of_exported(exported: jax.export.Exported, flat: list) -> _Program:
    def call(*flat: Any) -> Any:
        return exported.call(*flat)

    call.__name__ = exported.fun_name  # JAX tells what it compiles by that
    program = jax.jit(call, compiler_options=options())
    shapes = jax.tree.unflatten(exported.out_tree, exported.out_avals)
    return _later(functools.partial(program.lower, *flat), shapes)


def _later(lower: Callable, shapes: Any) -> _Program:
    wide = _wide()

    def compiled() -> Any:
        with jax.enable_x64(wide):  # which holds in the calling thread alone
            return lower().compile()

    told = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype), shapes)
    return _Program(_compilers().submit(compiled), told)


@functools.cache
def _prepare_lapack() -> None:
    """Makes JAX find LAPACK's functions: a loaded program calls them without looking."""
    jax.jit(jnp.linalg.cholesky).lower(np.eye(2, dtype=np.float32))
