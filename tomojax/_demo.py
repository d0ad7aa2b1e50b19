"""`tomojax demo`: no arguments, no files, a first look at what the library computes."""

from pathlib import Path

import jax
import numpy as np

import tomojax as tx
from tomojax import _plots


def run(out: Path) -> None:
    """Voltages of a simulated scene under all ground conditions: a table and a picture."""
    sensor = tx.Sensor.grid()
    scene = tx.Scene(
        tx.Disc([0.050, 0.110], 0.008, 2.0),
        tx.Bar([0.105, 0.060], 0.060, 0.010, 0.6, 1.0),
    )
    conductance = np.asarray(tx.contact_conductance(sensor, scene))
    volts = np.asarray(
        tx.voltages(sensor, scene, converter=tx.Converter(), key=jax.random.key(0))
    )
    print(
        f"{sensor.electrode_count} electrodes, {sensor.element_count} elements, "
        f"a disc and a bar of {1e3 * conductance.sum():.2f} mS in all"
    )
    print("grounded   lowest V   highest V   highest at")
    for ground in (0, 7, 27, 36, 56, 63):
        row = volts[ground]
        others = np.delete(row, ground)
        print(f"{ground:8d}   {others.min():8.4f}   {row.max():9.4f}   {row.argmax():10d}")
    out.mkdir(parents=True, exist_ok=True)
    path = out / "voltages.png"
    _plots.scene_and_voltages(sensor, conductance, volts, 27).savefig(path, dpi=130)
    print(f"picture: {path}")
