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
# # Where it fails
#
# The rows come from a committed run of `tomojax stability`. One thing gets worse from
# value to value, until each method fails. The limit is the last value up to which four
# scenes in five are within 10 mm of the truth. The image of `linear` tells an electrode
# near the contact; its limit asks for nine in ten within one and a half pitches, 30 mm.
# Beyond the limit a place that is over 20 mm off has to come with a flag: HIGH_RESIDUAL,
# CONTACTS_UNEXPLAINED, NO_CONTACT, NO_DATA or SOLVE_FAILED.
#
# `linear` has all 64 grounds, the others the two corners; `follow` grounds as it likes.

# %% tags=["hide-input"]
# %matplotlib inline
import json
import sys
from pathlib import Path

from IPython.display import display

sys.path += ["../tests/benchmarks", "tests/benchmarks"]  # of a checkout
from bench.stability import report

results = next(p for p in (Path("results"), Path("notebooks/results")) if p.is_dir())
found = json.loads((results / "stability.json").read_text())
limits, summary = found["rows"], found["summary"]
display(report.chart(summary["values"], limits))

# %% [markdown]
# A red ring marks what must not be: a place far off, of which nothing warns.

# %% tags=["hide-input"]
print(report.text(limits))

# %% tags=["hide-input"]
print(report.flagged_text(summary["flagged"]))

# %% [markdown]
# ## The numbers themselves
#
# The pictures compare solvers of Eq. 3 in float32 with float64, and derivatives of the
# whole pipeline with differences. They show how far apart places in float32 and float64
# are over all sweeps. Below stand images of Eq. 3 for a contact resistance ρ that is told
# wrongly, and where optimisers end that start at a bad λ.

# %% tags=["hide-input"]
display(report.numbers_chart(summary["numbers"], limits))
print(report.numbers_text(summary["numbers"]))
