# What the room offers, imported when it is first used.
from ._pairs import Pairs as Pairs
from ._recording import load as load, PairRecording as PairRecording
from ._response import (
    learn as learn,
    Located as Located,
    nominal as nominal,
    Response as Response,
)
from ._results import (
    located_text as located_text,
    summary_located as summary_located,
    write_results as write_results,
)
from ._sheet_change import (
    background as background,
    jacobian as jacobian,
    sensitivities as sensitivities,
)
from ._told import info_text as info_text, summary as summary

# The rest serves other rooms.
__all__ = [
    "background",
    "jacobian",
    "learn",
    "load",
    "Located",
    "nominal",
    "PairRecording",
    "Pairs",
    "Response",
    "sensitivities",
]
