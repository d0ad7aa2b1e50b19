"""Reads skins whose sheet changes: current between pairs of electrodes, and the sheet.

The room knows pairs of electrodes, their recordings, how voltages follow the sheet's
conductance, and responses that a rig learns. The room knows nothing of contacts that drive
the sheet.

The names of `__init__.pyi` are imported when they are first used: reading a file alone
waits for no JAX.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

# The rest serves other rooms.
__all__ = [
    "background",
    "Changes",
    "changes",
    "choose",
    "disc_model",
    "ElectrodeModel",
    "jacobian",
    "learn",
    "Levels",
    "LevelsFound",
    "load",
    "Located",
    "nominal",
    "PairRecording",
    "Pairs",
    "press_information",
    "PressInformation",
    "Response",
    "restrict",
    "rim_model",
    "sensitivities",
    "Transfer",
]
