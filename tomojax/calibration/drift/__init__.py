"""Follows a calibration over time: drift of zeros and gains, and whether it still fits.

The folder follows a rig with the calibration's own model. The folder finds no new sheet or
places.
"""

from tomojax.calibration.drift._adapter import (
    Adapter as Adapter,
    lone_places as lone_places,
    stretches as stretches,
)
from tomojax.calibration.drift._still_fits import (
    fit_text as fit_text,
    still_fits as still_fits,
)
