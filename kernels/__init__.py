"""Computes the sheet's physics with compiled, differentiable functions of arrays.

Functions here hold no state, read no files and check no values; `tomojax` does all three.
Each room exports its own functions (`tomojax.kernels.sheet`, `.inverse`, `.contacts`,
`.images`, `.scan`, and under them `.algebra`). `tomojax.kernels.flags` names the faults
that all rooms report for a frame; `.levels` and `.rectangle` serve NumPy as well as JAX.
"""
