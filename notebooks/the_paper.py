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
# # The paper's figures, redone
#
# Table I and Figs. 3 and 4 are predictions of the sheet's physics, made with one number of
# the paper (the width of *All*). Figs. 7 and 8 are reconstructions of recordings that
# another model of the rig made, beside what those recordings' truth says.

# %%
import json
import sys
from io import BytesIO
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from IPython.display import display, Image
from matplotlib import pyplot as plt

jax.config.update("jax_enable_x64", True)

import tomojax as tx
from tomojax.paper.table1 import plots, report, run

sys.path += ["../tests/benchmarks", "tests/benchmarks"]  # of a checkout
from bench.plots import sheet

# %% [markdown]
# ## Table I, Fig. 3 (images) and Fig. 4 (weighted score)
#
# `tomojax table1` does the same. *V line* and *Edge* change places with the paper's: its
# text does not say where its lines lie relative to the contact.

# %%
study = run()
print(report.text(study))
summary = report.summary(study)
assert summary["width_rank_correlation"] >= 0.90
assert summary["width_ratio_rms_relative_error"] <= 0.08

# %%
for draw in (plots.table, plots.images, plots.dependence):
    picture = BytesIO()
    draw(study).savefig(picture, dpi=80)
    display(Image(picture.getvalue()))

# %% [markdown]
# ## Fig. 7: single, double and areal contact under four patterns
#
# Each pattern is a selection of the recorded 64 slots. The first images have the λ of
# Table I, which makes them as wide as the paper's. The second have the library's own
# choice.

# %%
folder = Path.cwd()
while not (folder / "pyproject.toml").exists() and folder != folder.parent:
    folder = folder.parent
data = folder.parent / "shared" / "data"
sensor = tx.Sensor.grid(divisions=(40, 40))
reduced = tx.paper.reduce_jacobian(tx.jacobian(sensor))
SCENES = {"weight_off_centre": "single", "two_weights_60mm": "double", "cup_rim": "areal"}
NAMES = ("all", "around", "cop_line", "v_line")


def outline(axes, contact):
    turn = np.linspace(0, 2 * np.pi, 60)
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    for radius in [contact[k] for k in ("r", "r0", "r1") if k in contact]:
        axes.plot(*(1e3 * (np.array(contact["centre"]) + radius * ring)).T, "r", lw=0.8)


def figure_7(volts, scenes, lam):
    figure, grid = plt.subplots(3, 4, figsize=(15, 10), layout="constrained")
    for row, (name, title) in zip(grid, SCENES.items()):
        scene = scenes[name]
        frame = jnp.asarray(volts[slice(*scene["scans"])].mean(0))
        for axes, pattern in zip(row, NAMES):
            grounds = tx.pattern(sensor, pattern, frame[tx.paper.exploration(sensor)])
            result = tx.reconstruct(reduced, frame[grounds], grounds, lam=lam)
            image = np.asarray(result.image)
            sheet(axes, sensor, image / image.max(), "image / largest", vmin=0)
            for contact in scene["contacts"]:
                outline(axes, contact)
            width = 1e3 * float(tx.paper.figures_of_merit(sensor, image, image).half_width)
            axes.set_title(f"{title}, {pattern}: λ {float(result.lam):.2g}, {width:.0f} mm")
    plt.show()


if data.is_dir():
    import h5py

    with h5py.File(data / "static_all.h5") as file:
        volts = file["v"][:] * file.attrs["scale"] + file.attrs["offset"]
    listed = json.loads((data / "truth.json").read_text())["static_all"]["scenes"]
    scenes = {s["name"]: s for s in listed}
    figure_7(volts, scenes, float(study.lams[-1]))
    figure_7(volts, scenes, "cautious")
else:
    print("the recordings are not on this machine: Figs. 7 and 8 are left out")

# %% [markdown]
# ## Fig. 8: an object dropped, *All* against *CoP line*
#
# The same drop at 10 000 slots/s: 64 slots a scan, and two exploratory slots with eight of
# the line. The curves are the sum of each scan's image; the truth is the contact's
# conductance in every slot. A bounce shorter than a scan is blurred over the scan
# by *All* and followed by *CoP line*.


# %%
@jax.jit
def images(volts, grounds, lam):
    def one(frame_and_grounds):
        frame, chosen = frame_and_grounds
        result = tx.reconstruct(reduced, frame, chosen, lam=lam)
        return result.image.sum(), result.flags

    return jax.lax.map(one, (volts, grounds))


def runs(touched):
    """How many separate stretches of contact."""
    return int((np.diff(np.concatenate([[False], touched]).astype(int)) == 1).sum())


def bounce(name):
    with h5py.File(data / f"{name}.h5") as file:
        volts = file["v"][:] * file.attrs["scale"] + file.attrs["offset"]
        ground, t0 = file["ground"][:].astype(int), file["t0"][:]
        rate = file.attrs["f_switch"]
    truth = np.load(data / f"{name}.truth.npz")["total_conductance"]
    sums, flags = images(jnp.asarray(volts), jnp.asarray(ground), float(study.lams[-1]))
    assert not np.asarray(flags).any()
    middle = t0 - t0[0] + volts.shape[1] / 2 / rate
    return middle, np.asarray(sums), truth, rate


if data.is_dir():
    figure, grid = plt.subplots(2, 1, figsize=(14, 8), layout="constrained")
    for axes, thing in zip(grid, ("spanner", "orange")):
        for pattern in ("all", "copline"):
            t, sums, truth, rate = bounce(f"bounce_{thing}_{pattern}")
            touched = sums > 0.05 * sums.max()
            print(
                f"{thing:8s} {pattern:8s} stretches of contact: {runs(touched)}, ", end=""
            )
            print(f"in truth {runs(truth > 0.02 * truth.max())}, {len(t)} scans in 1 s")
            axes.plot(
                t, sums / sums.max(), ".-", ms=3, lw=0.8, label=f"{pattern}, image sum"
            )
        when = np.arange(len(truth)) / rate
        axes.plot(when, truth / truth.max(), "k", lw=0.8, label="truth, conductance")
        axes.set(xlabel="time, s", ylabel="value / its largest", title=thing)
        axes.legend()
    plt.show()
