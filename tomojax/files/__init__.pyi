# What the room offers, imported when it is first used.
from ._csv import read_csv as read_csv, Table as Table
from ._npz import read_npz as read_npz
from ._open import (
    is_mat as is_mat,
    open_container as open_container,
    OpenContainer as OpenContainer,
)
from ._readers import readers as readers
from ._text import (
    read_json as read_json,
    read_toml as read_toml,
)

# The rest serves other rooms.
__all__ = [
    "open_container",
    "OpenContainer",
    "read_csv",
    "read_json",
    "read_npz",
    "read_toml",
    "readers",
]
