"""`tomojax demo`: recordings that come with the package, found again beside their truth.

`_scenes` names the recordings, `_pictures` draws them. The room is an example of the
library's use; no other room imports it but the command's table. A checkout has
`tests/benchmarks/demo.py`, which simulates the recordings anew.
"""

from tomojax.cli.demo._command import demo as demo
from tomojax.cli.demo._scenes import SCENES as SCENES
