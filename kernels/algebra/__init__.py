"""Solves equations, filters series and searches for minima: compiled functions of arrays.

This room holds no physics: a matrix here may stand for anything. The room imports no other
room.
"""

from tomojax.kernels.algebra._adam import adam as adam
from tomojax.kernels.algebra._blocktri import (
    BlockTri as BlockTri,
    factor as factor,
    inverse_band as inverse_band,
    matmul as matmul,
    solve as solve,
    solve_positive as solve_positive,
)
from tomojax.kernels.algebra._descent import (
    descend as descend,
    Limits as Limits,
    Normal as Normal,
)
from tomojax.kernels.algebra._gaussian import gaussian as gaussian
from tomojax.kernels.algebra._halving import descended as descended, Run as Run
from tomojax.kernels.algebra._kalman import (
    filter_levels as filter_levels,
    Levels as Levels,
    Measured as Measured,
    smooth_levels as smooth_levels,
)
from tomojax.kernels.algebra._subsets import (
    draw_subset as draw_subset,
    drawn_weights as drawn_weights,
    heaviest as heaviest,
    least_weights as least_weights,
    project_weights as project_weights,
    subset_marginals as subset_marginals,
)
from tomojax.kernels.algebra._where_needed import (
    tree_where as tree_where,
    where_needed as where_needed,
)
