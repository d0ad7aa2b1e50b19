"""Finds what conducts less or more inside a body that electrodes surround, such as a tank.

The room knows the complete electrode model, and levels of conductance.
"""

from tomojax.ert.bodies._electrode_model import (
    disc_model,
    ElectrodeModel,
    rim_model,
    Transfer,
)
from tomojax.ert.bodies._levels import Levels, LevelsFound

__all__ = [
    "disc_model",
    "ElectrodeModel",
    "Levels",
    "LevelsFound",
    "rim_model",
    "Transfer",
]
