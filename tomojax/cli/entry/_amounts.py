"""Numbers on the command line: NaN and infinities are none, nor are amounts of nothing.

Values come as texts, or from a TOML file as whatever they are there.
"""

import math
from typing import Any

import click


class Number(click.ParamType):
    """A finite number; above 0 where it is an `amount`."""

    name = "float"

    def __init__(self, amount: bool = False):
        self._amount = amount

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        expected = "a number above 0" if self._amount else "a finite number"
        try:
            found = math.nan if isinstance(value, bool) else float(value)
        except (OverflowError, TypeError, ValueError):
            found = math.nan
        if not math.isfinite(found) or (self._amount and found <= 0):
            self.fail(f"got {value!r}, expected {expected}", param, ctx)
        return found


def whole_number(value: Any) -> int:
    """**Raises:** `ValueError` for what is no whole number: TOML has 2.5, true and inf."""
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ValueError(f"got {value!r}, expected a whole number")
    return int(value)


class Count(click.ParamType):
    """A whole number, 1 or more; nothing that is counted comes near the limit."""

    name = "integer"

    def convert(self, value: Any, param: Any, ctx: Any) -> int:
        try:
            found = whole_number(value)
        except ValueError:
            found = 0
        if not 1 <= found <= 10**9:
            self.fail(f"got {value!r}, expected a whole number, 1 or more", param, ctx)
        return found


NUMBER, AMOUNT, COUNT = Number(), Number(amount=True), Count()
