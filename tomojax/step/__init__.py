"""The step of a robot: one slot in, contacts and the next ground out, compiled once.

The folder holds policies and their tables too. The folder knows nothing of files of slots,
nor of the rig that a slot comes from.

The names of `__init__.pyi` are imported when they are first used.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

__all__ = [
    "ADAPTIVE",
    "load_policy",
    "Lookup",
    "make_step",
    "Output",
    "Packed",
    "POLICIES",
    "save_policy",
    "Step",
]
