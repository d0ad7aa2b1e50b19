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
# # Designing ground conditions
#
# Which eight of 64 electrodes are to be grounded? The information of slots adds up. So the
# question has a relaxed form, with weights instead of a set, and no set can beat its best
# value. `tomojax design --out .` does the same in one command.

# %%
import jax
import numpy as np
from matplotlib import pyplot as plt

import tomojax as tx

# Variances of a small λ want all digits.
jax.config.update("jax_enable_x64", True)
sensor = tx.Sensor.grid(divisions=(32, 32), dtype=np.float64)
xy = 1e3 * np.asarray(sensor.electrode_xy)

# %% [markdown]
# ## A set for all of the sheet
#
# The figure is the error of a contact's place that Cramér and Rao allow to `points`, in the
# mean over 48 contacts.

# %%
places = tx.design.design_places(sensor, count=48)
objective = tx.design.design_objective(sensor, places, "points", "place")
found = tx.design.design(objective, 8)
print("grounds", found.grounds)
print(f"{1e3 * found.value:.4f} mm, no set of eight is below {1e3 * found.bound:.4f}")
print(f"greedy {1e3 * found.greedy:.4f}, heaviest of the relaxed {1e3 * found.rounded:.4f}")

explored = tx.design.exploratory_voltages(sensor, places)
for row in tx.design.patterns_beside(sensor, objective, explored):
    mark = "knows the contact" if row["adaptive"] else ""
    print(f"{row['name']:10s} {row['slots']:3d} slots {1e3 * row['value']:.4f} mm {mark}")

# %% [markdown]
# ## A set for each place
#
# A scan that knows where the contact is, like *Around* after two slots, does better with a
# table by place. `tx.step.save_policy` writes it; `tomojax live --policy` and
# `tx.make_step`
# look it up. (Without `criterion` a table for `points` is for the error on simulated rigs,
# which counts errors that slots share, but has no bound.)

# %%
table = tx.design.design_policy(sensor, 8, criterion="place")
step = tx.make_step(
    sensor, "follow", "mine", tables={"mine": table.policy}, contacts=1, grid=16
)
print(f"at most {100 * (table.value / table.bound - 1).max():.2f} % above its bound")

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
fine = [(np.arange(32) + 0.5) / 32 * 0.16] * 2
grid = np.stack(np.meshgrid(*fine, indexing="ij"), -1).reshape(-1, 2)
chosen = np.zeros(64)
chosen[found.grounds] = 1
one_for_all = np.asarray(
    tx.design.design_objective(sensor, grid)(jax.numpy.asarray(chosen))
)
print(f"one set for all {1e3 * np.median(one_for_all):.4f} mm, in the median of the sheet")
print(f"a set for each place {1e3 * np.median(table.value):.4f} mm")
for axes, values, title in (
    (left, one_for_all.reshape(32, 32), "one set for all"),
    (right, table.value, "a set for each place"),
):
    image = axes.imshow(
        1e3 * values.T,
        origin="lower",
        extent=(0, 160, 0, 160),
        norm="log",
        vmin=0.04,
        vmax=1,
    )
    axes.plot(*xy.T, "o", color="w", mec="0.4", ms=4)
    axes.set(title=title, xlabel="x, mm", ylabel="y, mm")
left.plot(*xy[found.grounds].T, "o", color="#D55E00", ms=9)
figure.colorbar(image, ax=(left, right), label="place error, mm (1 σ)")
plt.show()

# %% [markdown]
# ## Through a simulation, with λ
#
# The images are those of Eq. 3, for contacts on rigs that differ from the sensor's nominal
# values. Gradients through the solve find λ and the length over which an image is smooth.

# %%
scenes = tx.design.simulate_scenes(
    sensor, tx.design.design_places(sensor, count=16), rigs=2
)
images = tx.design.ImageError.of(
    tx.method(sensor, "linear", 32), scenes, 0.008, smooth=True
)
tuned = tx.design.tune(images, jax.numpy.asarray(chosen))
length = float(jax.numpy.exp(tuned.objective.log_length))
print(f"λ {tuned.objective.lam:.3g}, smooth over {length:.2f} pixels")
print(f"error {float(tuned.value):.3f} after {tuned.solves} solves")

# %% [markdown]
# ## Places for electrodes
#
# Gradients through the sheet's Green's function move nine electrodes to where the image's
# resolution is best at the worst place.

# %%
nine = tx.Sensor.grid(3, 3, pitch=0.04, margin=0.02, divisions=(24, 24))
moved = tx.design.design_electrodes(nine, grid=12, starts=1)
print(
    f"worst spread {1e3 * moved.spread_before.max():.1f} mm on the uniform grid, ", end=""
)
print(f"{1e3 * moved.spread.max():.1f} mm so:")
print(np.round(1e3 * moved.electrode_xy, 1).tolist())
