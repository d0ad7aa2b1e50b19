"""Arrays in, arrays out: the sheet's physics as compiled, differentiable functions.

Nothing here holds state, reads files or checks values; `tomojax` does. Each room has a face
of its own (`tomojax.kernels.sheet`, `.inverse`, `.contacts`, `.images`, `.scan`, and under
them `.algebra`); `tomojax.kernels.flags` is what all of them say of a frame.
"""
