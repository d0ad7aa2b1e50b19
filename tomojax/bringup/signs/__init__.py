"""Signs of a rig that is wired or told wrongly, in any recording that shows a contact.

Levels need no model of the contact; orders of channels and grounds need lone contacts. In
NumPy and SciPy alone, for `tomojax info`. `check` finds more, of a recording made for it.
"""

from tomojax.bringup.signs._signs import find_signs as find_signs, Sign as Sign

__all__ = ["find_signs", "Sign"]
