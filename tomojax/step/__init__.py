"""The step of a robot: one slot in, contacts and the next ground out, compiled once.

The folder holds policies and their tables too. The folder knows nothing of files of slots,
nor of the rig that a slot comes from.
"""

from tomojax.step._make import check_followed as check_followed, make_step as make_step
from tomojax.step._packing import Packed as Packed
from tomojax.step._policies import (
    ADAPTIVE as ADAPTIVE,
    Lookup as Lookup,
    POLICIES as POLICIES,
)
from tomojax.step._state import Output as Output
from tomojax.step._step import Step as Step
from tomojax.step._tables import load_policy as load_policy, save_policy as save_policy

__all__ = [
    "ADAPTIVE",
    "load_policy",
    "Lookup",
    "make_step",
    "Output",
    "Packed",
    "POLICIES",
    "save_policy",
    "Step",
]
