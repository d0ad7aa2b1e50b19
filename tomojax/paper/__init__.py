"""Implements the paper's own method: ground patterns, Eq. 3, figures of merit.

This room applies Eq. 3 to any Jacobian, on arrays that a caller holds. The room knows
nothing of the ladder of methods, nor of files.
"""

from tomojax.paper._exported import load_exported
from tomojax.paper._merit import cell_size, Figures, figures_of_merit, pixels
from tomojax.paper._patterns import (
    AdaptivePattern,
    AdaptiveScan,
    exploration,
    pattern,
    PATTERNS,
)
from tomojax.paper._reconstruct import reconstruct, Reconstruction, reduce_jacobian

__all__ = [
    "AdaptivePattern",
    "AdaptiveScan",
    "cell_size",
    "exploration",
    "Figures",
    "figures_of_merit",
    "load_exported",
    "pattern",
    "PATTERNS",
    "pixels",
    "reconstruct",
    "Reconstruction",
    "reduce_jacobian",
]
