"""Implements the paper's own method: ground patterns, Eq. 3, figures of merit.

This room applies Eq. 3 to any Jacobian, on arrays that a caller holds. The room knows
nothing of the ladder of methods, nor of files.

The names of `__init__.pyi` are imported when they are first used.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

__all__ = [
    "AdaptivePattern",
    "AdaptiveScan",
    "cell_size",
    "exploration",
    "Figures",
    "figures_of_merit",
    "pattern",
    "PATTERNS",
    "pixels",
    "reconstruct",
    "Reconstruction",
    "reduce_jacobian",
]
