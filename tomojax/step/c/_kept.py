"""Keeps compiled steps in the user's cache folder, by all that they were made of."""

import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from tomojax._environment import cache_folder, drop_oldest
from tomojax._programs import source_digest
from tomojax._whole import ours
from tomojax.native import compile_c, compiler, PLAIN
from tomojax.step._state import About
from tomojax.step._traced import Traced
from tomojax.step.c._code import write_code
from tomojax.step.c._runs import NativeRuns

# The environment variable that names the folder of kept steps; empty, none are kept. And
# the one that says whether steps run as C where nobody asks: "0" for not.
FOLDER, WANTED = "TOMOJAX_STEPS", "TOMOJAX_NATIVE"

# Bytes of all kept steps: one of 64 electrodes takes 23 MB, nearly all of it tables.
LIMIT = 512 << 20

# Slots that check a compiler's work.
_CHECKED = 400

# GCC makes code that is as quick with these, in three fifths of -O3's time: the loops are
# short, and what -O3 moves between them is little. Clang takes what it knows of them.
_QUICK = (
    "-O2",
    "-ftree-vectorize",
    "-fvect-cost-model=dynamic",
    "-fpeel-loops",
    "-fno-gcse",
    "-fno-tree-pre",
)

# The files of a kept step.
_LIBRARY, _TABLES, _ABOUT = "step.so", "step.tables", "about.json"


def wanted() -> bool:
    """Whether steps run as C where nobody says so: on a processor, with a compiler."""
    asked = os.environ.get(WANTED, "1") != "0"
    return asked and jax.default_backend() == "cpu" and compiler() is not None


def folder_of(made_of: Any) -> Path | None:
    """Names the folder of a step by what it is made of; None where none can be kept.

    A class of the caller's own is code that no digest knows, and what lies in a folder that
    others can write would be run.
    """
    place = os.environ.get(FOLDER)
    if place == "":
        return None
    with suppress(OSError, RuntimeError):  # RuntimeError: the user has no home folder
        root = cache_folder("steps") if place is None else Path(place)
        key = _digest(made_of)
        if root is None or key is None:
            return None
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        if ours(root) and os.access(root, os.W_OK):
            return root / key
    return None


def kept(folder: Path | None) -> tuple[About, NativeRuns] | None:
    """Reads a step that was kept; None where none is there, or it cannot be read."""
    if folder is None or not (folder / _ABOUT).exists():
        return None
    try:
        return _read(folder, 0)
    except (OSError, ValueError, TypeError, KeyError):
        shutil.rmtree(folder, ignore_errors=True)  # it was cut short, or is damaged
        return None


def compiled(traced: Traced, folder: Path | None) -> tuple[About, NativeRuns]:
    """Compiles a step, and keeps it where there is a folder for it.

    **Raises:** `ValueError` where an operation has no C, or the compiler fails.
    """
    code = write_code(traced)
    home = tempfile.mkdtemp(
        prefix=".making-", dir=None if folder is None else folder.parent
    )
    part = Path(home)
    try:
        (part / "tomojax_step.h").write_text(code.header)
        (part / "step.c").write_text(code.source)
        (part / _TABLES).write_bytes(code.tables)
        told = {**traced.about._asdict(), "code": code.name}
        there = None if folder is None else _made_before(folder.parent, code.name)
        if there is None:
            _compile_checked(part, traced.about, code.name)
        else:
            shutil.copyfile(there, part / _LIBRARY)
        (part / _ABOUT).write_text(json.dumps(told))
        if folder is not None:
            # Another process may have been quicker.
            with suppress(OSError):
                part.rename(folder)
                part = folder
            drop_oldest(folder.parent.parent, "steps", LIMIT)
        return _read(part, traced.traces)
    finally:
        if part != folder:  # what is mapped stays until the process ends
            shutil.rmtree(home, ignore_errors=True)


def _made_before(root: Path, name: str) -> Path | None:
    """Finds a library of the same code: it serves every rig with arrays of its shapes."""
    for path in root.glob(f"*/{_ABOUT}"):
        with suppress(OSError, ValueError):
            same = json.loads(path.read_text())["code"] == name
            if same and kept(path.parent) is not None:  # which looks whether it is whole
                return path.with_name(_LIBRARY)
    return None


def _compile_checked(part: Path, about: About, name: str) -> None:
    """Compiles a step, and checks what the optimiser has made by the same without one.

    Both run from the same states. Sums are rounded otherwise, which decides otherwise where
    a slot lies between two decisions: that is one slot in thousands.

    **Raises:** `ValueError` where more slots differ.
    """
    plain = part / "plain.so"
    compile_c(part / "step.c", plain, *PLAIN)
    compile_c(part / "step.c", part / _LIBRARY, "-march=native", *_QUICK)
    files = part / _TABLES, name, 0
    quick, slow = (NativeRuns(about, lib, *files) for lib in (part / _LIBRARY, plain))
    plain.unlink()
    rng, state, differ = np.random.default_rng(0), slow.first, 0
    m, volts = about.electrode_count, np.zeros(0)
    for k in range(_CHECKED):
        if k % 20 == 0:  # as if a contact were near some electrode, or none
            near = np.exp(-np.abs(np.arange(m) - rng.integers(m)) / rng.uniform(1, m / 4))
            volts = about.drive * (0.1 + 0.6 * near) * (k % 80 > 0)
        slot = np.array([rng.integers(about.condition_count), 0, 0], np.int32)
        noisy = volts + rng.normal(0, 1e-3, m) * about.drive
        noisy = noisy.astype(about.dtype)
        others = quick.slot(state, noisy, slot)[1]
        state, said = slow.slot(state, noisy, slot)
        differ += not np.array_equal(said[1], others[1])
    if differ > _CHECKED // 50:
        told = f"{differ} of {_CHECKED} slots otherwise than without optimisation"
        raise ValueError(f"compiler: {compiler()} made code that answers {told}")


def _read(folder: Path, traces: int) -> tuple[About, NativeRuns]:
    told = json.loads((folder / _ABOUT).read_text())
    name = told.pop("code")
    told["policies"], told["image"] = tuple(told["policies"]), tuple(told["image"])
    about = About(**told)
    runs = NativeRuns(about, folder / _LIBRARY, folder / _TABLES, name, traces)
    with suppress(OSError):
        now = time.time()
        os.utime(folder / _TABLES, (now, now))  # used: the oldest go first
    return about, runs


def _digest(made_of: Any) -> str | None:
    """Digests what a step is made of; None where it holds what no digest knows."""
    arrays, still = eqx.partition(made_of, eqx.is_array_like)
    leaves, tree = jax.tree.flatten(arrays)
    told = repr((tree, jax.tree.leaves(still), jax.config.jax_enable_x64))  # pyright: ignore
    if re.search(r" at 0x[0-9a-f]+>", told):
        return None
    digest = hashlib.sha256((source_digest() + told).encode())
    for leaf in leaves:
        array = np.ascontiguousarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()[:40]
