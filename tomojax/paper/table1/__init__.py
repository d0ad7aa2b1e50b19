"""Predicts the paper's Table I, as any caller of the library would.

`run` follows the protocol. `report` has the numbers, and `plots` the pictures.
"""

from tomojax.paper.table1._study import PAPER as PAPER, run as run, Study as Study
