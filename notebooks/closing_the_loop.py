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
# # Closing the loop
#
# A rig sends a slot; the step says where the contact is and what to ground next; the rig
# grounds it. The rig here is a virtual one, in a process of its own. It simulates a
# contact that draws an eight, speaks the protocol of `hardware/PROTOCOL.md` over UDP and
# takes ground commands. A rig on a serial line needs only another name in `open_source`.

# %%
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import tomojax as tx
from tomojax.hardware import open_source, run, SlotRing
from tomojax.hardware.sources.virtual_rig import draw_eight, VirtualRig

folder = Path(tempfile.mkdtemp())
sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
draw_eight(sensor, folder / "scene.npz")
step = tx.make_step(sensor, "follow", ["around_contacts", "cop_line"], contacts=1)


# %% [markdown]
# ## By hand
#
# `read` fills an array and says what was grounded, whatever was asked for, and how many
# slots were lost before this one.

# %%
with VirtualRig(folder / "scene.npz", link="udp", rate=1000) as rig:
    with open_source(rig.where) as source:
        codes, state = np.zeros(64, np.int16), step.state
        for _ in range(300):
            got = source.read(codes)
            volts = source.scale * codes + source.offset
            state, out = step(state, volts, got.ground, got.lost)
            source.set_grounds([int(out.ground)])
        print(f"slot {got.number}, ground {got.ground}, next {int(out.ground)}")
        x, y = 1e3 * out.contacts.xy[0]
        print(f"{int(out.contacts.count)} contact, at {x:.2f}, {y:.2f} mm")

# %% [markdown]
# ## The live loop
#
# `run` does that until it is told to stop. It puts everything into a ring in shared
# memory, from which other processes record and draw. The rig here has faults. A fiftieth
# of the slots is lost, another is broken, and after a second the line is cut for 0.3 s.


# %%
def live(policy, seconds=3.0, **faults):
    """Rows of the ring, and what was counted."""
    ring = SlotRing.create(64, contacts=1)
    with VirtualRig(folder / "scene.npz", link="udp", rate=1000, **faults) as rig:
        with open_source(rig.where) as source:
            end = time.perf_counter() + seconds
            run(source, step, ring, policy=policy, until=lambda: time.perf_counter() > end)
    rows, _, _ = ring.since(0)
    counted, latency = ring.counted(), ring.latency(0.5, 0.99)
    ring.remove()
    return rows, counted, latency


rows, counted, latency = live(
    "around_contacts", loss=0.02, corrupt=0.02, disconnect=1.0, away=0.3
)
print({name: n for name, n in counted.items() if n})
print("last byte to ground command, 50 and 99 %:", [f"{1e6 * q:.0f} µs" for q in latency])
assert rows["number"][-1] + 1 == counted["slots"] + counted["lost"]

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
on = rows["count"] == 1
x, y = 1e3 * rows["xy"][on, 0].T
points = left.scatter(x, y, c=rows["time"][on], s=3)
figure.colorbar(points, label="time, s")
xy = 1e3 * np.asarray(sensor.electrode_xy)
left.plot(*xy.T, ".", color="0.8", zorder=0)
left.set(aspect="equal", xlabel="x, mm", ylabel="y, mm", title="The contact, slot by slot")
right.plot(rows["time"], rows["ground"], ".", ms=2)
right.set(xlabel="time, s", ylabel="electrode grounded", title="What was grounded")
plt.show()

# %% [markdown]
# The grounds go round the contact and move with it; while it is lifted, the corners take
# turns. Slots that were lost are gaps of the row's numbers, and nothing else.
