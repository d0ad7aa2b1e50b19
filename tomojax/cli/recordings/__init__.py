"""Commands on recordings: what they hold, what can be put right, and what touched.

Each module is one command, or what they share.
"""

from tomojax.cli.recordings._info import info as info
from tomojax.cli.recordings._opened import layout_option as layout_option, opened as opened
from tomojax.cli.recordings._reconstruct import reconstruct as reconstruct
from tomojax.cli.recordings._repair import repair as repair
