"""The method `points`: a few compact contacts, as many as the voltages ask for.

`sheet_of` prepares the sheet for a fit. The folder fits frames and knows nothing of the
other methods.
"""

# For the tests; the other rooms enter by `tomojax.methods`.
from tomojax.methods.points._found import Found as Found
from tomojax.methods.points._ladder import Ladder as Ladder, wants_curve as wants_curve
