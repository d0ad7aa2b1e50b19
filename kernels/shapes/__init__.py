"""Fits the shapes of contacts to voltages: a field says where an object touches.

Nearly everywhere an object either touches or does not. This room knows the sheet and the
errors of voltages. The room knows nothing of rigs, files or what an image is used for.
"""

from tomojax.kernels.shapes._field import (
    levels as levels,
    modes_of as modes_of,
    near_touching as near_touching,
    spread as spread,
    touching as touching,
    TwoLevels as TwoLevels,
)
from tomojax.kernels.shapes._fit import (
    Evaluated as Evaluated,
    fit_shape as fit_shape,
    followed as followed,
    PixelSites as PixelSites,
    Scene as Scene,
    shape_curvature as shape_curvature,
    shape_slopes as shape_slopes,
    ShapeFit as ShapeFit,
    Told as Told,
)
