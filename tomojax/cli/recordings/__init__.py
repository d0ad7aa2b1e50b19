"""Commands on recordings: `info`, `reconstruct` and `repair`.

Each module holds one command, or code that the commands share.
"""

from tomojax.cli.recordings._info import info as info
from tomojax.cli.recordings._opened import (
    layout_option as layout_option,
    opened as opened,
    stretch as stretch,
)
from tomojax.cli.recordings._pairs import (
    calibrate_pairs as calibrate_pairs,
    check_pairs as check_pairs,
    is_pairs as is_pairs,
)
from tomojax.cli.recordings._reconstruct import reconstruct as reconstruct
from tomojax.cli.recordings._repair import repair as repair
