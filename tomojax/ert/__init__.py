"""Finds what conducts unlike the rest between electrodes on the rim of a body.

Electrical resistance tomography: current goes in and out at electrodes on the rim, voltages
between others are read. Host code, in float64.
"""

from tomojax.ert._electrode_model import (
    disc_model as disc_model,
    ElectrodeModel as ElectrodeModel,
    rim_model as rim_model,
    Transfer as Transfer,
)
from tomojax.ert._levels import Levels as Levels, LevelsFound as LevelsFound

# The rest is what these return.
__all__ = [
    "disc_model",
    "ElectrodeModel",
    "Levels",
    "rim_model",
]
