# What the room offers, imported when it is first used.
from ._file import (
    Dataset as Dataset,
    partial_path as partial_path,
    ResultsFile as ResultsFile,
    write_rows as write_rows,
)
from ._outlines import (
    check_outlines as check_outlines,
    Outline as Outline,
    outlines_of as outlines_of,
    write_outlines as write_outlines,
)
from ._settings import default_method as default_method, Settings as Settings
from ._solving import Chosen as Chosen
from ._stream import (
    Made as Made,
    reconstruct_many as reconstruct_many,
    reconstruct_recording as reconstruct_recording,
)
from ._track import (
    Touch as Touch,
    touches as touches,
    track as track,
    Tracks as Tracks,
)
from .loading import (
    apply as apply,
    LoadedResults as LoadedResults,
    open_results as open_results,
)

# The rest serves other rooms.
__all__ = [
    "apply",
    "LoadedResults",
    "open_results",
    "Outline",
    "outlines_of",
    "reconstruct_many",
    "reconstruct_recording",
    "Settings",
    "Touch",
    "touches",
    "track",
    "Tracks",
]
