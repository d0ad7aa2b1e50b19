# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A sensor, its table of resistances, and recorded scenes
#
# This notebook shows the library's physics, and how close it comes to a rig of another
# model.

# %%
import json
import sys
from pathlib import Path

import jax
import numpy as np
from matplotlib import pyplot as plt

jax.config.update("jax_enable_x64", True)

import tomojax as tx

sys.path += ["../tests/benchmarks", "tests/benchmarks"]  # of a checkout
from bench import plots

sensor = tx.Sensor.grid()
table = tx.sensor.resistances(sensor)
print({name: part.shape for name, part in table._asdict().items()})

# %% [markdown]
# The first picture is the potential over the sheet when one ampere enters at electrode
# 27; the mean of all electrodes is zero. The others show one element in contact through 0
# Ω and 200 kΩ, and its effect on electrode 27 with corner 0 grounded. An imposed
# potential saturates, a current source does not. Colours start at 0: over the grounded
# electrode itself J(0) falls to about −0.3, which no contact on its metal would do (see
# `jacobian`).

# %%
figure, axes = plt.subplots(1, 3, figsize=(15, 4), layout="constrained")
plots.sheet(axes[0], sensor, table.elements[27], "potential, V per A")
axes[0].set_title("One ampere into electrode 27")
for axis, rho in zip(axes[1:], (0.0, 2e5)):
    j = tx.jacobian(sensor, [0], rho)
    plots.sheet(axis, sensor, j[0, 27], "J of electrode 27, V per V", vmin=0)
    axis.set_title(f"Contact through {rho:g} Ω, corner 0 grounded")

# %% [markdown]
# ## Recorded scenes
#
# `voltages` of a recording's true shapes stand beside the recorded volts, for all 64 ground
# conditions. The rig's sheet is uneven, its electrodes are misplaced and its channels
# noisy; the model has nominal values. The last column has metal discs that float
# (`electrode_shunt=1`) and the one sheet resistance that fits all scenes best.

# %%
folder = Path.cwd()
while not (folder / "pyproject.toml").exists() and folder != folder.parent:
    folder = folder.parent
data = folder.parent / "shared" / "data"


def true_conductance(sensor, contacts):
    g = np.zeros(sensor.element_count)
    for c in contacts:
        at, per_area = c["centre"], c["conductance"]
        if c["kind"] == "disc":
            shape = tx.Disc(at, c["r"], per_area)
        elif c["kind"] == "bar":
            shape = tx.Bar(at, c["length"], c["width"], c["angle"], per_area)
        else:
            shape = tx.Ring(at, c["r0"], c["r1"], per_area)
        one = np.asarray(tx.sensor.contact_conductance(sensor, shape))
        g += one * c["total_conductance"] / one.sum()
    return g


def misfit(sensor, scenes, volts):
    rms = []
    for scene in scenes:
        first, last = scene["scans"]
        model = tx.voltages(sensor, true_conductance(sensor, scene["contacts"]))
        rms.append(np.sqrt(((volts[first:last].mean(0) - model) ** 2).mean()))
    return np.array(rms)


if data.is_dir():
    import h5py

    with h5py.File(data / "static_all.h5") as file:
        volts = file["v"][:] * file.attrs["scale"]
    scenes = json.loads((data / "truth.json").read_text())["static_all"]["scenes"]
    largest = np.array([volts[slice(*s["scans"])].mean(0).max() for s in scenes])
    nominal = misfit(sensor, scenes, volts)
    shunted = {
        rho: misfit(tx.Sensor.grid(electrode_shunt=1, sheet_resistance=rho), scenes, volts)
        for rho in (1e4, 1.02e4, 1.04e4, 1.06e4, 1.08e4)
    }
    touched = np.array([bool(s["contacts"]) for s in scenes])
    best = min(shunted, key=lambda r: (shunted[r] / largest)[touched].mean())
    print(f"{'scene':24s} largest, V   nominal          floating discs, {best:g} Ω/sq")
    for i, scene in enumerate(scenes):
        if touched[i]:
            a, b = 100 * nominal[i] / largest[i], 100 * shunted[best][i] / largest[i]
            print(f"{scene['name']:24s} {largest[i]:8.3f}   {a:6.2f} %   {b:10.2f} %")
        else:
            print(f"{scene['name']:24s} {largest[i]:8.3f}   {1e3 * nominal[i]:6.2f} mV")
    assert (nominal / largest)[touched].max() <= 0.02 and nominal[0] <= 0.5e-3

    figure, axis = plt.subplots(figsize=(11, 4), layout="constrained")
    x = np.flatnonzero(touched)
    axis.bar(x - 0.2, 100 * (nominal / largest)[x], 0.4, label="nominal")
    axis.bar(x + 0.2, 100 * (shunted[best] / largest)[x], 0.4, label=f"floating, {best:g}")
    axis.set_xticks(x, [scenes[i]["name"] for i in x], rotation=30, ha="right")
    axis.set(ylabel="rms, % of largest voltage", title="Model beside recorded scenes")
    axis.legend()
    plt.show()
else:
    print("the recordings are not on this machine: this part is left out")
