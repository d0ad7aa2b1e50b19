"""Commands on rigs: `record`, `live`, `calibrate`, `check` and `compile-step`.

Each module holds one command, or code that the commands share.
"""

from tomojax.cli.rigs._calibrate import calibrate as calibrate
from tomojax.cli.rigs._check import check as check
from tomojax.cli.rigs._compile import compile_step as compile_step
from tomojax.cli.rigs._live import live as live
from tomojax.cli.rigs._record import record as record
