"""Commands on results files that `reconstruct` has written: `export`, `track` and `view`.

Each module is one command, or serves the page of `view`.
"""

from tomojax.cli.results._export import export as export
from tomojax.cli.results._track import track as track
from tomojax.cli.results._view import view as view
