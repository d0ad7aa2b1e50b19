"""Writes results in the formats of other tools.

Each module writes one kind of file. The library of a kind is an extra.
"""

from tomojax.exports._export import (
    beside as beside,
    check_kind as check_kind,
    ending as ending,
    export as export,
    Kind as Kind,
    KINDS as KINDS,
)
from tomojax.exports._source import Source as Source

__all__ = ["export", "Kind", "KINDS", "Source"]
