"""Results in the formats of other tools."""

__all__: list[str] = []
