"""Commands on results: what becomes of a file that `reconstruct` has written.

Each module is one command.
"""

from tomojax.cli.results._export import export as export
from tomojax.cli.results._track import track as track
from tomojax.cli.results._view import view as view
