# What the room offers, imported when it is first used.
from ._calibrate import (
    calibrate as calibrate,
    Calibrated as Calibrated,
    calibrated as calibrated,
    known_frames as known_frames,
)
from ._held import HeldCalibration as HeldCalibration
from ._pressure import (
    calibrate_presses as calibrate_presses,
    force as force,
    pressure as pressure,
)
from ._recording import (
    calibrate_recording as calibrate_recording,
    calibrated_recording as calibrated_recording,
    read_places as read_places,
    tare as tare,
)
from ._report import (
    picture as picture,
    rub_more as rub_more,
    squares_touched as squares_touched,
    summary as summary,
    text as text,
)
from ._unknowns import (
    rig_slopes as rig_slopes,
    slopes_by_rig as slopes_by_rig,
    unknowns_of as unknowns_of,
)
from .drift._adapter import (
    Adapter as Adapter,
    lone_places as lone_places,
    stretches as stretches,
)
from .drift._still_fits import fit_text as fit_text, still_fits as still_fits

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
