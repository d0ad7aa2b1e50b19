# What the room offers, imported when it is first used.
from ._npz import read_npz as read_npz
from ._open import (
    open_container as open_container,
    OpenContainer as OpenContainer,
)
from ._readers import readers as readers
from ._text import (
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
    "readers",
]
