"""Commands that repeat studies: `tomojax table1`, `frontier` and `stability`.

The room knows options and files; `tomojax.studies` does the work.
"""

from tomojax.cli.studies._frontier import frontier as frontier
from tomojax.cli.studies._stability import stability as stability
from tomojax.cli.studies._table1 import table1 as table1
