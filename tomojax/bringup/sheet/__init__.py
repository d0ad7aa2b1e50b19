"""Reads the sheet for `check`: slots of a recording, and one contact fitted to each.

These files know physics and the residuals of contacts. They know no fault.
"""

from tomojax.bringup.sheet._plane import Plane

__all__ = ["Plane"]
