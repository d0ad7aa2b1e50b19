"""Reads skins whose sheet changes: current between pairs of electrodes, and the sheet.

The room knows pairs of electrodes, their recordings, how voltages follow the sheet's
conductance, and responses that a rig learns. The room knows nothing of contacts that drive
the sheet.

The names of `__init__.pyi` are imported when they are first used: reading a file alone
waits for no JAX.
"""

from tomojax._require import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
