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
# # Which method for my scene
#
# The rows come from a committed run of `tomojax frontier`. Run it in a checkout of the
# repository on your own machine, with `--like REC` for your own sheet and electrodes, and
# put its `frontier.json` here.
#
# Voltages are a resistor network's with a rig's errors, which no method is told. A scene's
# place error is that of its worst contact.

# %% tags=["hide-input"]
# %matplotlib inline
import json
import sys
from pathlib import Path

from IPython.display import display

sys.path += ["../tests/benchmarks", "tests/benchmarks"]  # of a checkout
from bench.frontier import report

results = next(p for p in (Path("results"), Path("notebooks/results")) if p.is_dir())
found = json.loads((results / "frontier.json").read_text())
rows = found["rows"]
for name, value in found["environment"].items():
    print(f"{name}: {value}")

# %% [markdown]
# ## Speed against accuracy
#
# To the left is quicker, down is nearer. No method of ours is both quicker and nearer
# than the line, the front. Peers, which a lab would write without this package, are grey.

# %% tags=["hide-input"]
display(report.chart(rows))

# %% [markdown]
# ## The quickest for an accuracy
#
# The list has, for each kind of scene, the quickest row whose median place error is small
# enough. Nothing larger is needed: rows to the right of it buy accuracy alone.

# %% tags=["hide-input"]
for kind in report.KINDS:
    print(report.WORDS[kind])
    for wanted in (10, 3, 1, 0.5):
        some = [r for r in rows if r["scene"] == kind and not r["peer"]]
        near = [r for r in some if (report.error_mm(r) or 1e9) <= wanted]
        if near:
            best = min(near, key=lambda r: r["p50_us"])
            print(
                f"  {wanted:4} mm: {best['method']}, {best['pattern']} "
                f"({best['slots']} slots), {best['pixels']} pixels, {best['dtype']}: "
                f"{best['p50_us']:.0f} µs a frame, {best['batch']} in a call"
            )
