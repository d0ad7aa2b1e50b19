"""Turns recordings into results: a stream of chunks, results files, tracks, reports, plots.

The folder reads, applies a method and writes. The folder knows nothing of how a method
works, nor of how grounds are designed.

The names of `__init__.pyi` are imported when they are first used: reading a file alone
waits for no JAX.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

# The rest serves other rooms.
__all__ = [
    "apply",
    "LoadedResults",
    "open_results",
    "Outline",
    "outlines_of",
    "reconstruct_many",
    "reconstruct_recording",
    "Settings",
    "Touch",
    "touches",
    "track",
    "Tracks",
]
