"""Describes what touches the sheet: shapes with a conductance per area.

A shape gives the conductance per area (S/m²) at any point of the sheet. Outlines are signed
distances (negative inside). Across an outline the conductance falls over the distance
between two sample points. So the conductance is smooth in the shape's place and size.
"""

from abc import abstractmethod
from dataclasses import fields

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax._checks import checking
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
