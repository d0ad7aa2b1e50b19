"""Rates a set of ground conditions for a purpose, as figures of weights over slots.

The folder never imports a search.
"""

# For the tests; the other rooms enter by `tomojax.design`.
from tomojax.design.objectives._contacts import Contact as Contact
from tomojax.design.objectives._rigs import exact_on_rig as exact_on_rig
