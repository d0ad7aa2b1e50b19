"""Finds a rig's real zeros, gains, sheet and grounds from recorded contacts; and forces.

This room makes a `tomojax.Calibration`; the sensor room applies calibrations. This room
knows nothing of results.

The names of `__init__.pyi` are imported when they are first used.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

# The rest serves the command and tests.
__all__ = [
    "Adapter",
    "HeldCalibration",
    "calibrate",
    "calibrate_presses",
    "calibrate_recording",
    "calibrated_recording",
    "force",
    "pressure",
    "read_places",
    "still_fits",
    "tare",
]
