# What the room offers, imported when it is first used.
from ._changes import Changes as Changes, changes as changes
from ._check import check as check, PairFault as PairFault
from ._choice import (
    choose as choose,
    press_information as press_information,
    PressInformation as PressInformation,
    restrict as restrict,
)
from ._locator import Located as Located, Locator as Locator
from ._response import Response as Response
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
from ._teaching import learn as learn, nominal as nominal
from .bodies._electrode_model import (
    disc_model as disc_model,
    ElectrodeModel as ElectrodeModel,
    rim_model as rim_model,
    Transfer as Transfer,
)
from .bodies._levels import Levels as Levels, LevelsFound as LevelsFound
from .recorded._pairs import Pairs as Pairs
from .recorded._recording import load as load, PairRecording as PairRecording
from .recorded._told import info_text as info_text, summary as summary

# The rest serves other rooms.
__all__ = [
    "background",
    "Changes",
    "changes",
    "check",
    "choose",
    "disc_model",
    "ElectrodeModel",
    "jacobian",
    "learn",
    "Levels",
    "LevelsFound",
    "load",
    "Located",
    "Locator",
    "nominal",
    "PairRecording",
    "PairFault",
    "Pairs",
    "press_information",
    "PressInformation",
    "Response",
    "restrict",
    "rim_model",
    "sensitivities",
    "Transfer",
]
