"""Recordings to results: a stream of chunks, results files, tracks, reports, plots.

The room reads, applies a method and writes. It knows nothing of how a method works, nor of
how grounds are designed.
"""

from tomojax.results._chosen import Chosen as Chosen
from tomojax.results._file import partial_path as partial_path
from tomojax.results._outlines import (
    check_outlines as check_outlines,
    Outline as Outline,
    outlines_of as outlines_of,
    write_outlines as write_outlines,
)
from tomojax.results._settings import default_method as default_method, Settings as Settings
from tomojax.results._stream import reconstruct_recording as reconstruct_recording
from tomojax.results._track import (
    Touch as Touch,
    touches as touches,
    track as track,
    Tracks as Tracks,
)

# The rest serves other rooms.
__all__ = [
    "Outline",
    "outlines_of",
    "reconstruct_recording",
    "Settings",
    "Touch",
    "touches",
    "track",
    "Tracks",
]
