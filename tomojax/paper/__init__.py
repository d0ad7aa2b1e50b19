"""Implements the paper's own method: ground patterns, Eq. 3, figures of merit.

This room applies Eq. 3 to any Jacobian, on arrays that a caller holds. The room knows
nothing of the ladder of methods, nor of files.
"""

from tomojax.paper._exported import load_exported as load_exported
from tomojax.paper._merit import (
    cell_size as cell_size,
    Figures as Figures,
    figures_of_merit as figures_of_merit,
    pixels as pixels,
)
from tomojax.paper._patterns import (
    AdaptivePattern as AdaptivePattern,
    AdaptiveScan as AdaptiveScan,
    exploration as exploration,
    pattern as pattern,
    PATTERNS as PATTERNS,
)
from tomojax.paper._reconstruct import (
    reconstruct as reconstruct,
    Reconstruction as Reconstruction,
    reduce_jacobian as reduce_jacobian,
)

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
