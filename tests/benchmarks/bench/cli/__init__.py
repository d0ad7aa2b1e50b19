"""Commands that repeat studies: `tomojax frontier` and `tomojax stability`.

The room knows options and files; the studies do the work. `tomojax.cli` finds the room
where a checkout has it.
"""

from bench.cli._frontier import frontier as frontier
from bench.cli._stability import stability as stability
