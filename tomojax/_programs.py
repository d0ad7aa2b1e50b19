"""Compiled functions whose programs are kept between processes; and kept values.

JAX's own cache finds a program by what tracing and lowering give, which takes longer than
all the rest of a short command. This file finds a program by its name, source and
arguments.
"""

import functools
import hashlib
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable

from tomojax._forked import refuse_fork
from tomojax._whole import ours

# The environment variable that names the folder; without it nothing is kept, nor in a
# folder that others can write: a program that is read is run.
FOLDER = "TOMOJAX_PROGRAMS"

# XLA's CPU compiler takes half the time with these. What it makes runs as fast within 8 %,
# but `linear` 10 to 15 % slower: thousands of small operations gain little from the rest.
_QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}


class Kept:
    """A function of pytrees, compiled as `eqx.filter_jit` does; keeps its programs.

    A key names a program: the function's name, the package's source and the arguments. The
    key holds the arguments' structure, the arrays' shapes and types, and all other values.
    A program that cannot be kept is compiled all the same. Compilers run beside the caller:
    `begin` lets several programs compile side by side.

    """

    def __init__(self, function: Callable):
        functools.update_wrapper(self, function)
        self._function, self._inside = function, eqx.filter_jit(function)
        # On several devices arrays come in parts, which a program that is kept does not.
        self._shared = functools.cache(
            lambda: eqx.filter_jit(function, **{"compiler_options": options()})  # pyright: ignore
        )
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
                told = tree, still, tuple(map(repr, leaves)), shapes, _wide(), _device()
                path = _path(self._function, told, ".program")
                self._programs[key] = _made(self._function, args, flat, path)
        return self._programs[key], flat


_KEPT: list[Kept] = []


def kept(function: Callable) -> Kept:
    """Wraps a function in `Kept`."""
    return Kept(function)


def remembered(function: Callable) -> Callable:
    """Wraps a function of values that pickle; keeps on disk what the function returns."""

    @functools.wraps(function)
    def found(*args: Any) -> Any:
        told = _wide(), _device()
        if os.environ.get(FOLDER):
            told += (hashlib.sha256(pickle.dumps(args)).hexdigest(),)
        path = _path(function, told, ".value")
        if path is None:
            return function(*args)
        with suppress(Exception):  # a file that is not there yet, or was cut short
            return pickle.loads(path.read_bytes())
        made = function(*args)
        _write(path, made)
        return made

    return found


def forget() -> None:
    """Drops all kept programs of this process; `jax.clear_caches` drops JAX's own."""
    for one in _KEPT:
        one.forget()


def _wide() -> bool:
    """Tells what `jax.enable_x64` says in this thread; constants differ by it."""
    return jax.config.jax_enable_x64  # pyright: ignore


class _Program(NamedTuple):
    """A program that is compiled, or will be; and the shapes of what it returns."""

    compiled: Callable[[], Any]
    shapes: Any
    name: str  # of its file

    def __call__(self, flat: list) -> Any:
        if self.name:
            _used[self.name] = None
        try:
            found = self.compiled()(*flat)
            return jax.tree.unflatten(jax.tree.structure(self.shapes), found)
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


_heard = threading.local()  # programs that JAX's cache had, in each thread


def _hits() -> int:
    """Counts what JAX found in its cache in this thread."""
    _listen()
    return getattr(_heard, "hits", 0)


@functools.cache
def _listen() -> None:
    def heard(event: str, **_: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _heard.hits = getattr(_heard, "hits", 0) + 1

    jax.monitoring.register_event_listener(heard)


def _device() -> tuple:
    """Tells what else a program is compiled for: device, version, and the user's words."""
    precision = jax.config.jax_default_matmul_precision  # pyright: ignore
    told = jax.devices()[0].device_kind, jax.__version__, precision
    return *told, os.environ.get("XLA_FLAGS", "")


def _path(function: Callable, key: Any, ending: str) -> Path | None:
    """Returns the file for what a function makes under a key; None where none is kept."""
    folder = os.environ.get(FOLDER)
    if not folder or not ours(folder):
        return None
    names = function.__module__, function.__qualname__
    told = "\n".join([source_digest(), *names, repr(key)])
    digest = hashlib.sha256(told.encode()).hexdigest()
    return Path(folder) / f"{function.__name__.strip('_')}-{digest}{ending}"


def _write(path: Path, *things: Any) -> None:
    """Pickles things to a file, whole or not at all; what cannot be kept is not."""
    with suppress(Exception):  # a full disk, or something that does not pickle
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(b"".join(map(pickle.dumps, things)))
        part.replace(path)


@functools.cache
def source_digest() -> str:
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
    wide, trees = _wide(), []

    def traced(called: str = function.__name__) -> Any:
        arrays, static = eqx.partition(args, _is_array)
        tree = jax.tree.structure(arrays)

        def flattened(*flat: Any) -> Any:
            found = function(*eqx.combine(jax.tree.unflatten(tree, flat), static))
            leaves, told = jax.tree.flatten(found)
            trees.append(told)
            return tuple(leaves)

        flattened.__name__ = called  # JAX tells what it compiles by that
        return jax.jit(flattened, compiler_options=options()).trace(*flat)

    def made(begun: Any) -> Any:
        with jax.enable_x64(wide):  # which holds in the calling thread alone
            hits = _hits()
            compiled = (begun or traced()).lower().compile()
            # JAX cannot write what it found in its own cache; another name is not there.
            if path is not None and _hits() > hits:
                anew = f"{function.__name__}_{os.urandom(4).hex()}"
                compiled = traced(anew).lower().compile()
            if path is not None:
                _write(path, serialize_executable.serialize(compiled), shapes)
            return compiled

    @functools.cache  # once it is called: it may never be
    def read() -> Any:
        with suppress(Exception):  # a file that was cut short, or is of another JAX
            loading = _foreseen.pop(name, None)
            loaded, lapack = loading.result() if loading else _loaded(path)  # pyright: ignore
            if lapack:
                prepare_lapack()
            return loaded
        return made(None)

    name = "" if path is None else path.name
    if path is not None:
        with suppress(Exception), path.open("rb") as file:
            pickle.load(file)
            return _Program(read, pickle.load(file), name)
    begun = traced()
    told = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in begun.out_info]
    shapes = jax.tree.unflatten(trees[0], told)
    return _Program(_compilers().submit(made, begun).result, shapes, name)


def _loaded(path: Path) -> tuple[Any, bool]:
    """Reads a program, and tells whether it calls LAPACK; imports nothing of ours."""
    with path.open("rb") as file:
        found = pickle.load(file)
    return serialize_executable.deserialize_and_load(*found), b"lapack" in found[0]


# Programs that load before they are asked for, and those asked for, by their files' names.
_foreseen: dict[str, Future] = {}
_used: dict[str, None] = {}


@contextmanager
def foreseen(work: str) -> Iterator[None]:
    """Loads what the last process used for the same work, while this one goes on."""
    path = _path(foreseen, work, ".used")
    names = []
    with suppress(OSError):
        names = path.read_text().split() if path is not None else []
    for name in names:
        _foreseen[name] = _compilers().submit(_loaded, path.with_name(name))  # pyright: ignore
    yield
    if path is not None and sorted(names) != sorted(_used):
        with suppress(OSError):
            path.write_text("\n".join(_used))


@functools.cache
def prepare_lapack() -> None:
    """Makes JAX find LAPACK's functions: a loaded program calls them without looking."""
    jax.jit(jnp.linalg.cholesky).lower(np.eye(2, dtype=np.float32))
