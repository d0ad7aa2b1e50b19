"""Finds a rig's real zeros, gains, sheet and grounds from recorded contacts; and forces.

This room makes a `tomojax.Calibration`; the sensor room applies calibrations. This room
knows nothing of results.

The names of `__init__.pyi` are imported when they are first used.
"""

from tomojax._require import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
