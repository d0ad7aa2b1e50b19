"""Finds signs of wrong wires or wrong values, in any recording that shows a contact.

Levels need no model of the contact; orders of channels and grounds need lone contacts. The
code uses NumPy and SciPy alone, for `tomojax info`. `check` finds more, in a recording made
for `check`.
"""

from tomojax.bringup.signs._signs import find_signs, Sign

__all__ = ["find_signs", "Sign"]
