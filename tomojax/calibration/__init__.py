"""Finds a rig's real zeros, gains, sheet and grounds from recorded contacts; and forces.

This room makes a `tomojax.Calibration`; the sensor room applies calibrations. This room
knows nothing of results.
"""

from tomojax.calibration._calibrate import (
    calibrate as calibrate,
    Calibrated as Calibrated,
    calibrated as calibrated,
)
from tomojax.calibration._held import HeldCalibration as HeldCalibration
from tomojax.calibration._pressure import (
    calibrate_presses as calibrate_presses,
    force as force,
    pressure as pressure,
)
from tomojax.calibration._recording import (
    calibrate_recording as calibrate_recording,
    calibrated_recording as calibrated_recording,
    read_places as read_places,
)
from tomojax.calibration._report import (
    picture as picture,
    rub_more as rub_more,
    squares_touched as squares_touched,
    summary as summary,
    text as text,
)
from tomojax.calibration._slopes import (
    rig_slopes as rig_slopes,
    slopes_by_rig as slopes_by_rig,
)
from tomojax.calibration._tare import tare as tare
from tomojax.calibration._unknowns import unknowns_of as unknowns_of
from tomojax.calibration.drift import (
    Adapter as Adapter,
    fit_text as fit_text,
    lone_places as lone_places,
    still_fits as still_fits,
    stretches as stretches,
)

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
