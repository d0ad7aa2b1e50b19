"""Finds where each method fails, and what its flags say then, on a rig of another model.

The study uses the library as any caller would.
"""

from bench.stability._numbers import (
    gradient_rows as gradient_rows,
    pipeline as pipeline,
    random_points as random_points,
    RANGES as RANGES,
    small as small,
    solver_rows as solver_rows,
    symmetric_points as symmetric_points,
)
from bench.stability._scenes import Bench as Bench
from bench.stability._starts import (
    resistance_rows as resistance_rows,
    start_rows as start_rows,
)
from bench.stability._study import (
    CONTACTS as CONTACTS,
    FLAGGED as FLAGGED,
    HOLDS as HOLDS,
    holds as holds,
    limits as limits,
    numbers as numbers,
    right as right,
    run as run,
    SLOW_TESTS as SLOW_TESTS,
    SWEEPS as SWEEPS,
    takes_part as takes_part,
    Trial as Trial,
    trial_row as trial_row,
)
