"""Results in the formats of other tools.

Each module writes one kind of file. A kind's library is an extra.
"""

__all__: list[str] = []
