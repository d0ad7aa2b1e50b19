"""Solves the paper's Eq. 3: Tikhonov solves, bases of a Jacobian's rows, rules for λ.

This room takes any Jacobian. The room knows nothing of a Jacobian's origin, nor of what an
image shows.
"""

from tomojax.kernels.inverse._basis import (
    reduce_slots as reduce_slots,
    ReducedSlots as ReducedSlots,
    row_basis as row_basis,
    solve_damped as solve_damped,
    solve_reduced as solve_reduced,
)
from tomojax.kernels.inverse._lambda import (
    choose_lambda as choose_lambda,
    lambda_grid as lambda_grid,
    lambda_scores as lambda_scores,
    LambdaRule as LambdaRule,
    Spectrum as Spectrum,
    spectrum as spectrum,
    variance_components as variance_components,
)
from tomojax.kernels.inverse._smooth_map import (
    matern as matern,
    place_scores as place_scores,
    shrunk_covariance as shrunk_covariance,
    smooth_map as smooth_map,
    SmoothMap as SmoothMap,
)
from tomojax.kernels.inverse._tikhonov import SolveRoute as SolveRoute, tikhonov as tikhonov
