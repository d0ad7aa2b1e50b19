"""Writes a step as a folder of C: source, header, tables, libraries, examples, vectors."""

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.native import compile_c, FLAGS, make_archive
from tomojax.sensor import Disc, Scene, Sensor, voltages
from tomojax.step._traced import Traced
from tomojax.step.c._code import Code, filled, write_code

# Files that are copied as they are, and those with facts filled in.
_PLAIN = ("check.c", "example.c", "ros2_node.cpp", "tomojax_step.hpp")
_FILLED = ("CMakeLists.txt", "tomojax_step.pc")

# Test vectors: slots, and those that one scene holds.
_VECTORS, _HELD = 10_000, 50


def write_folder(
    traced: Traced, folder: Path, march: str, libraries: bool, halved: bool
) -> Code:
    """Writes the files of `compile`; the folder is there whole or not at all.

    **Raises:** `ValueError` for a folder that holds other files, for an operation that has
    no C, and where no compiler is there or it fails.
    """
    folder = Path(folder)
    others = sorted(folder.iterdir()) if folder.is_dir() else []
    fits = not folder.exists() or not others or (folder / "tomojax_step.h").exists()
    require(fits, "folder", f"{folder}, with other files", "a new folder, or a step's")
    code = write_code(traced, halved)
    folder.parent.mkdir(parents=True, exist_ok=True)
    home = Path(tempfile.mkdtemp(prefix=".writing-", dir=folder.parent))
    try:
        told = {**code.told, "FLAGS": " ".join(FLAGS[1:])}
        (home / "step.c").write_text(code.source)
        (home / "tomojax_step.h").write_text(code.header)
        (home / "step.tables").write_bytes(code.tables)
        for name in _PLAIN:
            shutil.copyfile(Path(__file__).parent / name, home / name)
        for name in _FILLED:
            (home / name).write_text(filled(name, told))
        _write_vectors(traced, home)
        if libraries:
            compile_c(home / "step.c", home / "step.o", "-c", f"-march={march}")
            compile_c(home / "step.o", home / "libtomojax_step.so")
            make_archive(home / "step.o", home / "libtomojax_step.a")
            (home / "step.o").unlink()
        home.chmod(0o777 & ~_umask())
        if folder.exists():
            shutil.rmtree(folder)
        home.rename(folder)
    finally:
        shutil.rmtree(home, ignore_errors=True)
    return code


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _write_vectors(traced: Traced, home: Path) -> None:
    """Writes slots with the memory before each, and what JAX's program says of them.

    The loop is closed: the ground of each slot is the one that was asked for. Discs are of
    the sensor's own model, with noise and faults: vectors show that C does as JAX does,
    and nothing of the method's accuracy.
    """
    rng, sensor = np.random.default_rng(0), traced.sensor
    state, (volts, _) = traced.state, traced.slot
    ground = int(np.asarray(state.whole)[traced.about.ground_at])
    levels = _levels(sensor, rng, 0)
    zero, gain = traced.zero_and_gain
    most = min(2, traced.contact_count)
    with (home / "vectors.bin").open("wb") as file:
        for k in range(_VECTORS):
            if k % _HELD == 0:
                levels = _levels(sensor, rng, k // _HELD % (1 + most))
            volts = levels[ground] * gain + zero + rng.normal(0, 3e-4, levels.shape[1])
            slot = np.array([ground, 0, 0], np.int32)
            if rng.random() < 0.05:
                volts, slot = _faulty(volts, slot, rng, k)
            volts = volts.astype(traced.dtype)
            before = [np.asarray(a) for a in state]
            state, said = traced.compiled(state, volts, slot)
            for array in (*before, volts, slot, *map(np.asarray, said)):
                file.write(array.tobytes())
            ground = int(traced.said.unpack(tuple(map(np.asarray, said))).ground)


def _levels(sensor: Sensor, rng: np.random.Generator, count: int) -> np.ndarray:
    """Computes volts of all conditions with so many discs somewhere."""
    if count == 0:
        return np.zeros((sensor.condition_count, sensor.electrode_count))
    # Between electrodes: one on a ground is read as well as nothing.
    ends = rng.integers(sensor.electrode_count, size=(2, count))
    one, other = np.asarray(sensor.electrode_xy)[ends]
    places = one + 0.37 * (other - one)
    radius = 0.6 * float(np.max(np.asarray(sensor.electrode_diameter)))
    return np.asarray(voltages(sensor, Scene(*(Disc(p, radius, 1.0) for p in places))))


def _faulty(volts: np.ndarray, slot: np.ndarray, rng: Any, k: int) -> tuple:
    """Returns a slot with one of the faults that rigs have."""
    volts, slot, one = volts.copy(), slot.copy(), rng.integers(len(volts))
    if k % 5 == 0:
        volts[one] = np.nan
    elif k % 5 == 1:
        volts[:] = 0
    elif k % 5 == 2:
        volts[one] = 1e3
    elif k % 5 == 3:
        slot[0] = -1
    else:
        slot[1] = 7
    return volts, slot
