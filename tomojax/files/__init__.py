"""Reads files from outside, whatever they hold, or says in one line why not.

HDF5, MCAP and TDMS are read in a process of their own, with limits. On damaged bytes, their
libraries may loop, crash or open other files. The folder knows nothing of recordings or
results, and imports no JAX.

The names of `__init__.pyi` are imported when they are first used.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
