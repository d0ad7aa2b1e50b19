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
# # A recording, from file to plots
#
# This notebook does in Python what `tomojax reconstruct` does. It opens a recording, writes
# its rows to a results file chunk by chunk, and plots from that file. The recording is the
# demo's, forty times over; a recording of hours is no different.

# %%
import tempfile
from importlib.resources import files
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
from IPython.display import display, Image
from matplotlib import pyplot as plt

import tomojax as tx

folder = Path(tempfile.mkdtemp())
with (
    h5py.File(str(files("tomojax") / "demo.h5")) as short,
    h5py.File(folder / "long.h5", "w") as long,
):
    times = 40
    scans, interval = len(short["v"]), 0.01
    rng = np.random.default_rng(0)
    noise = np.round(rng.normal(0, 2, (times * scans, *short["v"].shape[1:])))
    long["v"] = (np.tile(short["v"][:], (times, 1, 1)) + noise).astype(np.int16)
    long["ground"] = np.tile(short["ground"][:], (times, 1))
    long["t0"] = np.arange(times * scans) * interval
    long["gaps"], long["electrode_xy"] = short["gaps"][:], short["electrode_xy"][:]
    long.attrs.update(short.attrs)
    # A channel that dies for ten seconds.
    long["v"][2000:3000, :, 27] = 0

# %% [markdown]
# ## Two runs: a row for each scan with its image, and a row for each slot

# %%
with tx.open_recording(folder / "long.h5") as recording:
    print(recording.scans, "scans of", recording.slots, "slots;", recording.rig.notes)
    by_scan = tx.reconstruct_recording(recording, folder / "scans.h5")
    settings = tx.results.Settings(rate="slot", images=False)
    by_slot = tx.reconstruct_recording(recording, folder / "slots.h5", settings)

with h5py.File(by_scan) as file:
    print({name: (data.shape, data.attrs["unit"]) for name, data in file.items()})
    print("λ/σ₁² =", file.attrs["lam_relative"])

# %% [markdown]
# ## Contacts over time, and what was wrong with the input

# %%
from tomojax.results import plots

figure = plots.timeline(by_scan)
figure.set_size_inches(12, 7)
picture = BytesIO()
figure.savefig(picture, dpi=80)
display(Image(picture.getvalue()))

# %%
with h5py.File(by_scan) as file:
    flags, count, t = file["flags"][:], file["contact_count"][:], file["t"][:]
for flag in tx.Flag:
    rows = np.flatnonzero(flags & flag.value)
    if rows.size:
        print(f"{flag.name:12s} {rows.size:5d} rows, from {t[rows[0]]:.2f} s")
dead = np.flatnonzero(flags & tx.Flag.DEAD_CHANNEL.value)
assert dead[0] == 2000 and dead[-1] == 2999

# %% [markdown]
# ## Where a finger was most
#
# A map of the time that contacts spent at each place, from all slots.

# %%
with h5py.File(by_slot) as file:
    xy = file["contact_xy"][:].reshape(-1, 2)
    current = file["contact_current"][:].ravel()
there = np.isfinite(current)
fig, axes = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
for axis, weights, title in zip(
    axes, (None, 1e6 * current[there]), ("slots", "current, µA·slots")
):
    places = 1e3 * xy[there].T
    sheet = [[0, 160], [0, 160]]
    style = dict(bins=64, range=sheet, norm="log", cmap="magma", weights=weights)
    *_, picture = axis.hist2d(*places, **style)
    axis.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", facecolor="k")
    fig.colorbar(picture, ax=axis, label=title)
axes[0].set_title("Where contacts were")
axes[1].set_title("Where current flowed")
plt.show()

# %% [markdown]
# ## The same without files
#
# `Batch` is the pipeline over arrays: any grounds, channels left out, all devices.

# %%
with tx.open_recording(folder / "long.h5") as recording:
    some = recording.read(0, 200)
    sensor = recording.rig.sensor()
faults = tx.find_faults(some.voltages, some.grounds, 4.5)
method = tx.method(sensor, "source", 40)
batch = tx.Batch(method, 1e-4 * method.scale())
rows = batch(some.voltages, some.grounds, faults.good)
plt.figure(figsize=(5, 4))
plt.imshow(rows.image[60].T, origin="lower", extent=(0, 160, 0, 160), cmap="magma")
plt.plot(*(1e3 * rows.contact_xy[60].T), "c+")
plt.colorbar(label=f"image, {method.image_unit.replace('^2', '²')}")
plt.gca().set(xlabel="x, mm", ylabel="y, mm", title="The 61st scan; cross: the contact")
plt.show()
print("contacts of the 61st scan, mm:", 1e3 * rows.contact_xy[60, : rows.contact_count[60]])
