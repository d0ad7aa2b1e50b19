"""The method `points`: a few compact contacts, as many as the voltages ask for.

`sheet_of` has what a fit is told of the sheet. The room fits frames; it knows nothing of
the other methods.
"""

from tomojax.methods.points._found import fitting_of as fitting_of
from tomojax.methods.points._points import Points as Points
from tomojax.methods.points._sheet import sheet_of as sheet_of, UNIT as UNIT
