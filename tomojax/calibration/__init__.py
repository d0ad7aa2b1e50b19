"""What a rig really is: zeros, gains, sheet and grounds, from recorded contacts; forces.

The room makes a `tomojax.Calibration`; the sensor room applies it. It knows nothing of
results.
"""

from tomojax.calibration._calibrate import calibrate as calibrate
from tomojax.calibration._pressure import (
    calibrate_presses as calibrate_presses,
    force as force,
    pressure as pressure,
)
from tomojax.calibration._recording import (
    calibrate_recording as calibrate_recording,
    read_places as read_places,
    tare as tare,
)

__all__ = [
    "calibrate",
    "calibrate_presses",
    "calibrate_recording",
    "force",
    "pressure",
    "read_places",
    "tare",
]
