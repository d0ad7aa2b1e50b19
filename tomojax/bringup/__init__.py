"""Finds what is wrong with a new rig, and how to mend it.

This room judges recordings of nothing, of a rub and of two corners, in NumPy alone. It
knows the sheet's physics and nothing of methods or of how slots come in.
"""

from tomojax.bringup import signs
from tomojax.bringup._check import check
from tomojax.bringup._fault import Checked, Fault
from tomojax.bringup._report import picture, summary, text, write_order

__all__ = [
    "check",
    "Checked",
    "Fault",
    "picture",
    "signs",
    "summary",
    "text",
    "write_order",
]
