"""Starts virtual rigs, and makes scenes for them."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import jax

    import tomojax.sensor


class VirtualRig:
    """A virtual rig in a process of its own, from `with` to its end.

    `where` is the name that `open_source` takes. `scene` is a file made by `write_scene`.
    `options` are those of `python -m tomojax.hardware.sources.virtual`: link="udp",
    loss=0.01, ….
    """

    def __init__(self, scene: Path | str, **options: Any):
        words = [str(scene)]
        for name, value in options.items():
            values = value if isinstance(value, list | tuple) else [value]
            words += [f"--{name}", *map(str, values)]
        command = [sys.executable, "-m", "tomojax.hardware.sources.virtual", *words]
        command.append("--attached")
        pipe = subprocess.PIPE
        # Ctrl-C in the terminal is for who started it.
        group = 0 if os.name == "posix" else None
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, text=True, process_group=group
        )
        assert self._process.stdout is not None
        try:
            told = self._process.stdout.readline()
        except BaseException:  # Ctrl-C, before there is anything to end
            self._process.kill()
            self._process.communicate()
            raise
        if not told:
            raise ValueError(f"scene: {scene}: the virtual rig did not start")
        self.where: str = json.loads(told)["where"]
        self.slots: int | None = None  # of its whole life, once it has ended

    def __enter__(self) -> "VirtualRig":
        return self

    def __exit__(self, *_: Any) -> None:
        self.stop()

    def stop(self) -> None:
        if self._process.poll() is None:
            if os.name == "nt":  # no Ctrl-C for a process alone: what it sent is not told
                self._process.terminate()
            else:
                self._process.send_signal(2)
        told, _ = self._process.communicate(timeout=10)
        if told:
            self.slots = json.loads(told.splitlines()[-1])["slots"]


def write_scene(
    path: Path | str,
    voltages: np.ndarray,
    dwell: float,
    conditions: np.ndarray | None = None,
) -> None:
    """Writes voltages (K, L, M), V, of K moments under each ground, each `dwell` s long.

    `conditions` (L, M): the table of ground conditions, S, that the rig takes.
    """
    arrays: dict[str, Any] = {"voltages": np.asarray(voltages, np.float32), "dwell": dwell}
    if conditions is not None:
        arrays["conditions"] = np.asarray(conditions)
    np.savez(path, **arrays)


def draw_eight(
    sensor: "tomojax.sensor.Sensor", path: Path | str, moments: int = 60
) -> None:
    """Makes a scene: a contact of 7 mm draws an eight in a second and is lifted once."""
    import jax  # the rig itself, which plays scenes, starts without
    import jax.numpy as jnp

    import tomojax as tx

    size = np.asarray(sensor.size, float)

    @jax.jit
    def moment(t: "jax.Array") -> "jax.Array":
        turn = 2 * jnp.pi * t
        away = jnp.stack([0.28 * jnp.sin(turn), 0.22 * jnp.sin(2 * turn)])
        place = ((0.5 + away) * size).astype(sensor.dtype)
        g = tx.sensor.contact_conductance(sensor, tx.Disc(place, 0.007, 0.5))
        return tx.voltages(sensor, jnp.where(t > 0.9, 0, g))

    each = [np.asarray(moment(jnp.asarray(k / moments))) for k in range(moments)]
    table = None if sensor.conditions is None else np.asarray(sensor.conditions)
    write_scene(path, np.stack(each), 1 / moments, table)
