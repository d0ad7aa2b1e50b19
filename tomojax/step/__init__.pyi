# What the room offers, imported when it is first used.
from ._make import check_followed as check_followed, make_step as make_step
from ._packing import Packed as Packed
from ._policies import (
    ADAPTIVE as ADAPTIVE,
    Lookup as Lookup,
    POLICIES as POLICIES,
)
from ._state import Output as Output
from ._step import Step as Step
from ._tables import load_policy as load_policy, save_policy as save_policy

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
