"""True shapes of a recording through `voltages`, against the recorded volts.

The rig is not our model: 1 mm network, uneven sheet, misplaced electrodes, gain errors,
offsets and noise. Its truth gives each contact's shape, the centre and the total
conductance that the rig's raster made of it; both are used.
"""

import json

import h5py
import jax.numpy as jnp
import numpy as np

import tomojax as tx


def true_conductance(sensor: tx.Sensor, contact: dict) -> jnp.ndarray:
    at, per_area = contact["centre"], contact["conductance"]
    shape = {
        "disc": lambda: tx.Disc(at, contact["r"], per_area),
        "bar": lambda: tx.Bar(
            at, contact["length"], contact["width"], contact["angle"], per_area
        ),
        "ring": lambda: tx.Ring(at, contact["r0"], contact["r1"], per_area),
    }[contact["kind"]]()
    g = tx.sensor.contact_conductance(sensor, shape)
    return g * (contact["total_conductance"] / g.sum())


def test_static_scenes(shared_data) -> None:
    with h5py.File(shared_data / "static_all.h5") as file:
        volts = file["v"][:] * file.attrs["scale"] + file.attrs["offset"]
        ground = file["ground"][:]
        sensor = tx.Sensor(
            file.attrs["size"],
            file["electrode_xy"][:],
            file.attrs["electrode_diameter"],
            file.attrs["sheet_resistance"],
            file.attrs["ground_resistance"],
            file.attrs["drive_voltage"],
        )
    scenes = json.loads((shared_data / "truth.json").read_text())["static_all"]["scenes"]
    assert len(scenes) == 14
    for scene in scenes:
        first, last = scene["scans"]
        g = sum(
            (true_conductance(sensor, c) for c in scene["contacts"]),
            jnp.zeros(sensor.element_count),
        )
        model = np.asarray(tx.voltages(sensor, g, ground[first].astype(int)))
        measured = volts[first:last].mean(0)
        rms = np.sqrt(((measured - model) ** 2).mean())
        if scene["contacts"]:
            assert rms <= 0.02 * np.abs(measured).max(), (scene["name"], rms)
        else:
            assert rms <= 0.5e-3, rms
