"""Reads files from outside, whatever they hold, or says in one line why not.

HDF5, MCAP and TDMS are read in a process of their own, with limits. On damaged bytes, their
libraries may loop, crash or open other files. The folder knows nothing of recordings or
results, and imports no JAX.
"""

from tomojax.files._npz import read_npz as read_npz
from tomojax.files._open import (
    open_container as open_container,
    OpenContainer as OpenContainer,
)
from tomojax.files._text import (
    read_json as read_json,
    read_table as read_table,
    read_toml as read_toml,
)

__all__ = [
    "open_container",
    "OpenContainer",
    "read_json",
    "read_npz",
    "read_table",
    "read_toml",
]
