"""The method `points`: a few compact contacts, as many as the voltages ask for.

`sheet_of` prepares the sheet for a fit. The folder fits frames and knows nothing of the
other methods.
"""

from tomojax.methods.points._found import fitting_of as fitting_of, Found as Found
from tomojax.methods.points._ladder import Ladder as Ladder, wants_curve as wants_curve
from tomojax.methods.points._points import (
    Points as Points,
    sheet_of as sheet_of,
    UNIT as UNIT,
)
