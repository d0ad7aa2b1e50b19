"""Defines the fields of a row of results: name, shape, type and unit of each."""

from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, get_args, get_type_hints, NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from tomojax._shown import named, numbers_of, tuple_shown

# A row's flags are judged by these: they are offered beside `Rows`.
from tomojax.kernels.flags import DOUBT as DOUBT, NO_ANSWER as NO_ANSWER


class Column(NamedTuple):
    """A field's stored type and unit."""

    kind: str  # NumPy's type
    unit: str


class Field(NamedTuple):
    """A field of `Rows`: the names of its sizes, its stored type and its unit."""

    sizes: tuple[str, ...]
    kind: str
    unit: str


_Number = np.ndarray


class Rows(NamedTuple):
    """Results of n frames, as in the results file; C contacts a frame, strongest first.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = np.asarray(tx.voltages(sensor, touch, [0, 15]))
    >>> batch = tx.Batch(method, method.choose_lambda([]), contacts=2)
    >>> rows = batch(np.stack([volts, 0 * volts]), np.array([[0, 15], [0, 15]]))
    >>> print(rows.contact_count, rows.image.shape)
    [1 0] (2, 16, 16)
    >>> tx.Flag(int(rows.flags[1])).name
    'NO_CONTACT'
    >>> rows.take(rows.contact_count > 0).contact_xy.shape
    (1, 2, 2)
    """

    contact_count: Annotated[Integer[_Number, " n"], Column("<u1", "1")]
    contact_xy: Annotated[Float[_Number, "n C 2"], Column("<f4", "m")]
    contact_radius: Annotated[Float[_Number, "n C"], Column("<f4", "m")]
    contact_angle: Annotated[Float[_Number, "n C"], Column("<f4", "rad")]
    contact_current: Annotated[Float[_Number, "n C"], Column("<f4", "A")]
    contact_conductance: Annotated[Float[_Number, "n C"], Column("<f4", "S")]
    # of the place: xx, yy, xy
    contact_covariance: Annotated[Float[_Number, "n C 3"], Column("<f4", "m^2")]
    residual: Annotated[Float[_Number, " n"], Column("<f4", "V")]  # rms
    flags: Annotated[Integer[_Number, " n"], Column("<u4", "1")]  # bits of `Flag`
    rung: Annotated[Integer[_Number, " n"], Column("<u1", "1")]  # see `Rung`; else 0
    # With images alone; the unit of an image is its method's.
    image: Annotated[Float[_Number, "n nx ny"] | None, Column("<f4", "")] = None
    residual_by_electrode: Annotated[Float[_Number, "n M"] | None, Column("<f4", "V")] = (
        None
    )
    # Of `shape` alone: the probability that a pixel touches; the image's deviation.
    touch: Annotated[Float[_Number, "n tx ty"] | None, Column("<f4", "1")] = None
    image_deviation: Annotated[Float[_Number, "n tx ty"] | None, Column("<f4", "")] = None

    def __repr__(self) -> str:
        count, flags = numbers_of(self.contact_count), numbers_of(self.flags)
        if count is None or flags is None or count.ndim != 1:
            return tuple_shown(self)
        silent = flags & int(NO_ANSWER) > 0
        doubted = (flags & int(DOUBT) > 0) & ~silent
        told = {
            "frames": str(len(count)),
            "contacts_at_most": str(self.contact_xy.shape[1]),
            "with_contacts": str(int((count > 0).sum())),
            "in_doubt": str(int(doubted.sum())),
            "without_answer": str(int(silent.sum())),
        }
        if self.image is not None:
            told["image"] = " × ".join(map(str, self.image.shape[1:]))
        return named(self, **told)

    @classmethod
    def of(cls, contacts: Any, **others: Any) -> "Rows":
        """Makes rows from `Contacts`, of one frame or n, and the other fields."""
        named = {f"contact_{name}": value for name, value in contacts._asdict().items()}
        return cls(**named, **others)

    def put(self, index: Any, rows: "Rows") -> None:
        """Overwrites the rows at `index` (NumPy)."""
        for mine, theirs in zip(self, rows):
            if mine is not None:
                mine[index] = theirs

    @staticmethod
    def joined(parts: "Sequence[Rows]") -> "Rows":
        """Joins the rows of several parts (NumPy), one part after the other."""
        whole = (None if a[0] is None else np.concatenate(a) for a in zip(*parts))
        return Rows(*whole)  # pyright: ignore

    def take(self, index: Any) -> "Rows":
        """Selects rows by an index, a slice or a mask."""
        return Rows(*(None if a is None else a[index] for a in self))  # pyright: ignore


@cache
def fields_of_rows() -> dict[str, Field]:
    """Lists the fields of `Rows` in order, read off the annotations.

    **Example:**

    >>> import tomojax as tx
    >>> field = tx.methods.fields_of_rows()["contact_xy"]
    >>> field.sizes, field.kind, field.unit
    (('C', '2'), '<f4', 'm')
    """
    found = {}
    for name, hint in get_type_hints(Rows, include_extras=True).items():
        kind, column = get_args(hint)
        shape = (get_args(kind) or (kind,))[0].dim_str.split()
        found[name] = Field(tuple(shape[1:]), *column)
    return found


def empty_rows(n: int, sizes: dict[str, int]) -> Rows:
    """Makes rows that say nothing: NaN, and 0 in whole numbers.

    `sizes` gives numbers to the names in `Field.sizes`; a field without its size is None.

    **Example:**

    >>> import tomojax as tx
    >>> rows = tx.methods.empty_rows(2, {"C": 3})
    >>> rows.contact_xy.shape, rows.image is None, int(rows.contact_count.sum())
    ((2, 3, 2), True, 0)
    """
    made = {}
    for name, field in fields_of_rows().items():
        # A size is a number, or a name of one that may not be known.
        shape = [int(sizes.get(s, s if s.isdigit() else -1)) for s in field.sizes]
        if min(shape, default=0) >= 0:
            nothing = np.nan if np.dtype(field.kind).kind == "f" else 0
            made[name] = np.full((n, *shape), nothing, field.kind)
    return Rows(**made)
