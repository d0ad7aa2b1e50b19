"""The method `points`: a few compact contacts, as many as the voltages ask for.

`sheet_of` prepares the sheet for a fit. The folder fits frames and knows nothing of the
other methods.
"""

from tomojax.methods.points._found import fitting_of as fitting_of
from tomojax.methods.points._points import Points as Points
from tomojax.methods.points._sheet import sheet_of as sheet_of, UNIT as UNIT
