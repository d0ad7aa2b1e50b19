"""Makes the demo's recording: `python -m tomojax.cli._demo_recording FILE`.

One finger draws an eight, and a second finger taps. A scan has three slots: two opposite
corners and a third corner are grounded in turn. The recording has 200 scans of a rig whose
sheet is uneven by 3 %.
"""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

import sys
from pathlib import Path

import h5py
import jax
import jax.numpy as jnp
import numpy as np

import tomojax as tx

_SCANS, _GROUNDS, _PERIOD = 200, (0, 63, 56), 0.01


def voltages() -> np.ndarray:
    """Simulates voltages (scans, slots, 64), V, exact for the uneven sheet."""
    uneven = np.indices((64, 64)).sum(0) / 63
    sheet = 10e3 * (1 + 0.03 * np.sin(2 * np.pi * uneven))
    sensor = tx.Sensor.grid(sheet_resistance=np.repeat(sheet.ravel(), 2))
    base = jnp.asarray(_GROUNDS)

    @jax.jit
    def scan(t):
        turn = 2 * jnp.pi * t
        place = jnp.array([0.08 + 0.045 * jnp.sin(turn), 0.08 + 0.035 * jnp.sin(2 * turn)])
        press = 3e-1 * (1 + 0.8 * jnp.sin(3 * turn))
        tap = jnp.where(jnp.sin(8 * turn) > 0.3, 0.5, 0.0)
        scene = tx.Scene(tx.Disc(place, 0.007, press), tx.Disc([0.04, 0.125], 0.006, tap))
        lifted = (t > 0.47) & (t < 0.53)
        g = jnp.where(lifted, 0.0, tx.sensor.contact_conductance(sensor, scene))
        return tx.voltages(sensor, g, base)

    return np.stack([np.asarray(scan(k / _SCANS)) for k in range(_SCANS)])


def write(path: Path) -> None:
    """Writes 16-bit voltages with gain errors of 0.05 %, offsets and noise of 0.3 mV."""
    rng = np.random.default_rng(0)
    v = voltages() * rng.normal(1, 5e-4, 64) + rng.normal(0, 3e-4, 64)
    scale = 5 / 32768
    codes = np.round((v + rng.normal(0, 3e-4, v.shape)) / scale).astype(np.int16)
    sensor = tx.Sensor.grid()
    with h5py.File(path, "w") as file:
        file.create_dataset("v", data=codes, compression="gzip", shuffle=True)
        file["ground"] = np.broadcast_to(np.uint8(_GROUNDS), codes.shape[:2])
        file["t0"] = np.arange(_SCANS) * _PERIOD
        file["gaps"] = np.zeros((0, 2), np.int64)
        file["electrode_xy"] = np.round(np.asarray(sensor.electrode_xy, float), 6)
        file.attrs.update(
            schema="tomojax-recording",
            schema_version=1,
            f_switch=10e3,
            scale=scale,
            offset=0.0,
            drive_voltage=4.5,
            ground_resistance=4.0,
            sheet_resistance=10e3,
            size=[0.16, 0.16],
            electrode_diameter=0.005,
            settle_delay=2e-5,
            convert_period=1e-6,
            units="V",
            notes="one finger draws an eight, another taps (simulated)",
        )


if __name__ == "__main__":
    write(Path(sys.argv[1]))
