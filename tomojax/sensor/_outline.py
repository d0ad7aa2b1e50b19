"""Describes what touches the sheet: shapes with a conductance per area.

A shape gives the conductance per area (S/m²) at any point of the sheet. Outlines are signed
distances (negative inside). Across an outline the conductance falls over the distance
between two sample points. So the conductance is smooth in the shape's place and size.

Scenes are made of shapes: any contact on cells, several at once, displaced, moving.
"""

from abc import abstractmethod
from dataclasses import fields

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax._checks import checked, checking, require, require_array
from tomojax._custom_types import Numbers
from tomojax._shown import named, shown

Points = Float[Array, "*points 2"]
Density = Float[Array, "*points"]


class AbstractShape(eqx.Module):
    """A contact.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> class Everywhere(tx.sensor.AbstractShape):
    ...     def density(self, points, blur, size):
    ...         return jnp.full(points.shape[:-1], 0.1, points.dtype)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> tx.voltages(sensor, Everywhere(), [0, 15]).shape
    (2, 16)
    """

    @abstractmethod
    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        """Conductance per area (S/m²) at `points` (m) on a sheet of `size` (m)."""

    def __repr__(self) -> str:
        return named(self, **{f.name: shown(getattr(self, f.name)) for f in fields(self)})


class AbstractOutline(AbstractShape):
    """A contact of even conductance inside an outline.

    **Example:**

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> class Square(tx.sensor.AbstractOutline):
    ...     conductance: jax.Array
    ...     def distance(self, points):  # to a square of 20 mm at the sheet's corner
    ...         return points.max(-1) - 0.02
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, Square(jnp.array(2.0))).sum()
    >>> print(f"{1e6 * float(siemens):.0f} µS")  # 2 S/m² on 400 mm²
    800 µS
    """

    conductance: eqx.AbstractVar[Float[Array, ""]]

    @abstractmethod
    def distance(self, points: Points) -> Density:
        """Distance to the outline, m, negative inside."""

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        inside = jnp.clip(0.5 - self.distance(points) / blur, 0, 1)
        return self.conductance * inside**2 * (3 - 2 * inside)


def norm(vector: Float[Array, "*points 2"]) -> Density:
    """|v| with a zero gradient at v = 0, where jnp.linalg.norm has NaN."""
    square = (vector**2).sum(-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def turned(points: Points, center: Array, angle: Array) -> Points:
    """`points` in axes at `center`, turned by `angle`."""
    x, y = jnp.moveaxis(points - center, -1, 0)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * x + sin * y, cos * y - sin * x], -1)


checked_center = checking("center", "finite", (2,))
checked_angle = checking("angle", "finite")
checked_conductance = checking("conductance", "not negative", ())


# Shapes of a scene that are printed.
_SHOWN = 4


class Mask(AbstractShape):
    """Any contact, as conductance per area (nx, ny), S/m², on even cells of the sheet.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> cells = np.zeros((4, 4))
    >>> cells[1, 2] = 1.0  # one sixteenth of the sheet: 400 mm²
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, tx.sensor.Mask(cells)).sum()
    >>> print(f"{1e6 * float(siemens):.0f} µS")
    400 µS
    """

    conductance: Float[Array, "nx ny"] = eqx.field(
        converter=checking("conductance", "not negative", (None, None))
    )

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        cells = jnp.array(self.conductance.shape)
        index = jnp.floor(points / size * cells.astype(size.dtype)).astype(int)
        on_sheet = ((index >= 0) & (index < cells)).all(-1)
        i, j = jnp.moveaxis(jnp.clip(index, 0, cells - 1), -1, 0)
        return jnp.where(on_sheet, self.conductance[i, j], 0)


class Scene(AbstractShape):
    """Several contacts on the sheet at once; a scene of no shape is an untouched sheet.

    **Example:**

    >>> import tomojax as tx
    >>> two = tx.Scene(tx.Disc([0.02, 0.06], 0.005, 1.0), tx.Disc([0.06, 0.02], 0.005, 1.0))
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> tx.voltages(sensor, two, [0, 15]).shape
    (2, 16)
    >>> float(tx.voltages(sensor, tx.Scene(), [0, 15]).max())  # nothing touches
    0.0
    """

    shapes: tuple[AbstractShape, ...]

    def __init__(self, *shapes: AbstractShape):
        for shape in shapes:
            require(isinstance(shape, AbstractShape), "shapes", repr(shape), "shapes")
        self.shapes = shapes

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        zero = jnp.zeros(points.shape[:-1], points.dtype)
        return sum((s.density(points, blur, size) for s in self.shapes), zero)

    def __repr__(self) -> str:
        count, each = len(self.shapes), [repr(shape) for shape in self.shapes[:_SHOWN]]
        more = [f"… {count} shapes"] if count > _SHOWN else []
        return f"Scene({', '.join(each + more)})"


class Shifted(AbstractShape):
    """A shape displaced by `offset` (2,) m, its conductance times `factor`.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> disc = tx.Disc([0.03, 0.03], 0.006, 1.0)
    >>> lighter = tx.sensor.Shifted(disc, jnp.array([0.02, 0.0]), jnp.array(0.5))
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> before, after = (
    ...     tx.sensor.contact_conductance(sensor, shape).sum() for shape in (disc, lighter)
    ... )
    >>> print(f"{float(after / before):.2f}")
    0.50
    """

    shape: AbstractShape
    offset: Float[Array, "2"]
    factor: Float[Array, ""]

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        return self.factor * self.shape.density(points - self.offset, blur, size)


class Moving(eqx.Module):
    """A shape that moves and changes its pressure, linearly between given times.

    **Arguments:** `shape`; `times` (n,) s, increasing; `offsets` (n, 2) m from where
    the shape stands; `factors` (n,) on its conductance. A call with a time gives the shape
    at that time. Any function of time that returns a shape serves as well.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import numpy as np
    >>> import tomojax as tx
    >>> disc = tx.Disc([0.02, 0.04], 0.006, 1.0)
    >>> slide = tx.sensor.Moving(disc, times=[0.0, 1.0], offsets=[[0, 0], [0.04, 0]])
    >>> halfway = slide(jnp.array(0.5))
    >>> print(np.round(1e3 * halfway.offset))  # mm
    [20.  0.]
    """

    shape: AbstractShape
    times: Float[Array, " n"]
    offsets: Float[Array, "n 2"]
    factors: Float[Array, " n"]

    def __init__(
        self,
        shape: AbstractShape,
        times: Numbers,
        offsets: Numbers,
        factors: Numbers = 1.0,
    ):
        require(isinstance(shape, AbstractShape), "shape", repr(shape), "a shape")
        self.shape = shape
        self.times = checked("times", times, "finite", (None,))
        require_array("steps between times", self.times[1:] - self.times[:-1], "positive")
        count = len(self.times)
        self.offsets = checked("offsets", offsets, "finite", (count, 2))
        given = checked("factors", factors, "not negative", (), (count,))
        self.factors = jnp.broadcast_to(given, self.times.shape)

    def __call__(self, time: Float[Array, ""]) -> Shifted:
        at = lambda values: jnp.interp(time, self.times, values)  # noqa: E731
        offset = jax.vmap(at, 1)(self.offsets)
        return Shifted(self.shape, offset, at(self.factors))
