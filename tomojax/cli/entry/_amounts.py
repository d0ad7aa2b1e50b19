"""Types of options that are numbers: NaN and infinities are refused.

An amount and a count must be above 0. Values come as texts, or from a TOML file as Python
values.
"""

import math
from typing import Any

import click


class Number(click.ParamType):
    """A finite number; above 0 for an `amount`."""

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
    """Turns a value into an integer.

    **Raises:** `ValueError` for anything but a whole number: TOML has 2.5, true and inf.
    """
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ValueError(f"got {value!r}, expected a whole number")
    return int(value)


class Count(click.ParamType):
    """A whole number from 1 to 10⁹; nothing that is counted comes near the limit."""

    name = "integer"

    def convert(self, value: Any, param: Any, ctx: Any) -> int:
        try:
            found = whole_number(value)
        except ValueError:
            found = 0
        if not 1 <= found <= 10**9:
            self.fail(f"got {value!r}, expected a whole number, 1 or more", param, ctx)
        return found


class Pair(click.ParamType):
    """Two numbers with a mark between, of which none is below 0; or one of some words.

    `words`: each word's value.
    """

    def __init__(
        self,
        kind: type[int] | type[float],
        name: str,
        expected: str = "",
        mark: str = ",",
        words: dict[str, Any] | None = None,
    ):
        self._kind, self.name, self._mark, self._words = kind, name, mark, words or {}
        self._expected = expected or name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value in self._words:
            return self._words[value]
        try:
            one, other = (self._kind(part) for part in value.split(self._mark))
        except ValueError:
            one = other = -1
        if not (0 <= one < math.inf and 0 <= other < math.inf):
            self.fail(f"got {value!r}, expected {self._expected}", param, ctx)
        return one, other


NUMBER, AMOUNT, COUNT = Number(), Number(amount=True), Count()
