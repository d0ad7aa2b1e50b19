"""The ladder of models: from the voltages of a frame to contacts and an image.

Each method has a file of its own and keeps one contract. `method` finds a method by name;
`Batch` applies a method to many frames. The folder knows nothing of files, nor of the next
ground.

The names of `__init__.pyi` are imported when they are first used: reading a file alone
waits for no JAX.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

# The rest serves other rooms.
__all__ = [
    "AbstractMethod",
    "Batch",
    "DOUBT",
    "empty_rows",
    "Estimate",
    "estimate",
    "fields_of_rows",
    "Frame",
    "ImageShape",
    "Linear",
    "method",
    "METHODS",
    "NO_ANSWER",
    "Points",
    "Ready",
    "Rows",
    "Rung",
    "Source",
]
