"""A step as C: the folder that users get, and the library that Python calls.

The files beside these modules are the step's face in C, with gaps to be filled in.
"""

from tomojax.step.c._folder import write_folder as write_folder
from tomojax.step.c._kept import (
    compiled as compiled,
    folder_of as folder_of,
    kept as kept,
    wanted as wanted,
)
from tomojax.step.c._runs import (
    AbstractRuns as AbstractRuns,
    InC as InC,
    JaxRuns as JaxRuns,
)

__all__ = [
    "AbstractRuns",
    "compiled",
    "folder_of",
    "InC",
    "JaxRuns",
    "kept",
    "wanted",
    "write_folder",
]
