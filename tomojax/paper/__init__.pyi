# What the room offers, imported when it is first used.
from ._merit import (
    cell_size as cell_size,
    Figures as Figures,
    figures_of_merit as figures_of_merit,
    pixels as pixels,
)
from ._patterns import (
    AdaptivePattern as AdaptivePattern,
    AdaptiveScan as AdaptiveScan,
    exploration as exploration,
    pattern as pattern,
    PATTERNS as PATTERNS,
)
from ._reconstruct import (
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
    "pattern",
    "PATTERNS",
    "pixels",
    "reconstruct",
    "Reconstruction",
    "reduce_jacobian",
]
