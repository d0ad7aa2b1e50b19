"""Describes what touches the sheet: shapes with a conductance per area.

A shape gives the conductance per area (S/m²) at any point of the sheet. Outlines are signed
distances (negative inside). Across an outline the conductance falls over the distance
between two sample points. So the conductance is smooth in the shape's place and size.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax._checks import (
    float_array,
    require,
    require_finite,
    require_not_negative,
    require_positive,
    require_shape,
)
from tomojax._custom_types import Numbers

Points = Float[Array, "*points 2"]
Density = Float[Array, "*points"]


class AbstractShape(eqx.Module):
    """A contact on the sheet.

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
        """Returns conductance per area (S/m²) at `points` (m) on a sheet of `size` (m)."""


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
        """Returns the distance to the outline, m, negative inside."""

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        inside = jnp.clip(0.5 - self.distance(points) / blur, 0, 1)
        return self.conductance * inside**2 * (3 - 2 * inside)


def _length(vector: Float[Array, "*points 2"]) -> Density:
    """Computes |v| with a zero gradient at v = 0, where jnp.linalg.norm has NaN."""
    square = (vector**2).sum(-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _turned(points: Points, center: Array, angle: Array) -> Points:
    """Returns `points` in axes at `center`, turned by `angle`."""
    x, y = jnp.moveaxis(points - center, -1, 0)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * x + sin * y, cos * y - sin * x], -1)


def _center(value: Numbers) -> Array:
    center = float_array("center", value)
    require_shape("center", center, (2,))
    require_finite("center", center)
    return center


def _lengths(**values: Numbers) -> list[Array]:
    arrays = [float_array(name, value) for name, value in values.items()]
    for name, array in zip(values, arrays):
        require_shape(name, array, ())
        require_positive(name, array)
    return arrays


def _conductance(value: Numbers) -> Array:
    conductance = float_array("conductance", value)
    require_shape("conductance", conductance, ())
    require_not_negative("conductance", conductance)
    return conductance


class Disc(AbstractOutline):
    """A round contact: `center` (2,) m, `radius` m, `conductance` S/m².

    **Example:**

    >>> import tomojax as tx
    >>> disc = tx.Disc([0.03, 0.05], radius=0.006, conductance=0.5)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, disc).sum()
    >>> print(f"{1e6 * float(siemens):.0f} µS")  # 0.5 S/m² on π·(6 mm)²
    57 µS
    """

    center: Float[Array, "2"]
    radius: Float[Array, ""]
    conductance: Float[Array, ""]

    def __init__(self, center: Numbers, radius: Numbers, conductance: Numbers):
        self.center = _center(center)
        (self.radius,) = _lengths(radius=radius)
        self.conductance = _conductance(conductance)

    def distance(self, points: Points) -> Density:
        return _length(points - self.center) - self.radius


class Ellipse(AbstractOutline):
    """An ellipse of `semi_axes` (2,) m, the first turned by `angle` (rad) from the x axis.

    **Example:**

    >>> import tomojax as tx
    >>> flat = tx.Ellipse([0.04, 0.04], [0.03, 0.01], angle=0.0, conductance=1.0)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, flat).sum()
    >>> print(f"{1e3 * float(siemens):.2f} mS")  # 1 S/m² on π·(30 mm)·(10 mm)
    0.94 mS
    """

    center: Float[Array, "2"]
    semi_axes: Float[Array, "2"]
    angle: Float[Array, ""]
    conductance: Float[Array, ""]

    def __init__(
        self,
        center: Numbers,
        semi_axes: Numbers,
        angle: Numbers,
        conductance: Numbers,
    ):
        self.center = _center(center)
        self.semi_axes = float_array("semi_axes", semi_axes)
        require_shape("semi_axes", self.semi_axes, (2,))
        require_positive("semi_axes", self.semi_axes)
        self.angle = float_array("angle", angle)
        require_finite("angle", self.angle)
        self.conductance = _conductance(conductance)

    def distance(self, points: Points) -> Density:
        # First order in the distance, exact on the outline: all that `density` uses.
        local = _turned(points, self.center, self.angle)
        scaled = _length(local / self.semi_axes)
        slope = _length(local / self.semi_axes**2)
        middle = slope == 0
        return jnp.where(
            middle,
            -self.semi_axes.min(),
            scaled * (scaled - 1) / jnp.where(middle, 1, slope),
        )


class Bar(AbstractOutline):
    """A rectangle, `length` m along `angle` (rad) from the x axis and `width` m across.

    **Example:**

    >>> import tomojax as tx
    >>> bar = tx.Bar([0.04, 0.04], length=0.06, width=0.01, angle=0.0, conductance=1.0)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, bar).sum()
    >>> print(f"{1e6 * float(siemens):.0f} µS")  # 1 S/m² on 60 mm × 10 mm
    600 µS
    """

    center: Float[Array, "2"]
    length: Float[Array, ""]
    width: Float[Array, ""]
    angle: Float[Array, ""]
    conductance: Float[Array, ""]

    def __init__(
        self,
        center: Numbers,
        length: Numbers,
        width: Numbers,
        angle: Numbers,
        conductance: Numbers,
    ):
        self.center = _center(center)
        self.length, self.width = _lengths(length=length, width=width)
        self.angle = float_array("angle", angle)
        require_finite("angle", self.angle)
        self.conductance = _conductance(conductance)

    def distance(self, points: Points) -> Density:
        local = _turned(points, self.center, self.angle)
        beyond = jnp.abs(local) - jnp.stack([self.length, self.width]) / 2
        return _length(jnp.maximum(beyond, 0)) + jnp.minimum(beyond.max(-1), 0)


class Ring(AbstractOutline):
    """A rim between the radii `inner` and `outer`, m.

    **Example:**

    >>> import tomojax as tx
    >>> ring = tx.Ring([0.04, 0.04], inner=0.015, outer=0.025, conductance=1.0)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> image = tx.paper.pixels(sensor, tx.sensor.contact_conductance(sensor, ring))
    >>> float(image[7, 7]), bool(image[3, 7] > 0)  # its middle is open
    (0.0, True)
    """

    center: Float[Array, "2"]
    inner: Float[Array, ""]
    outer: Float[Array, ""]
    conductance: Float[Array, ""]

    def __init__(
        self,
        center: Numbers,
        inner: Numbers,
        outer: Numbers,
        conductance: Numbers,
    ):
        self.center = _center(center)
        self.inner, self.outer = _lengths(inner=inner, outer=outer)
        require_positive("outer − inner", self.outer - self.inner)
        self.conductance = _conductance(conductance)

    def distance(self, points: Points) -> Density:
        radius = _length(points - self.center)
        return jnp.abs(radius - (self.inner + self.outer) / 2) - (
            (self.outer - self.inner) / 2
        )


class Polygon(AbstractOutline):
    """A polygon of `vertices` (n, 2) m in order around the outline, either way round.

    **Example:**

    >>> import tomojax as tx
    >>> corner = tx.sensor.Polygon([[0, 0], [0.04, 0], [0, 0.04]], conductance=1.0)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, corner).sum()
    >>> print(f"{1e6 * float(siemens):.0f} µS")  # 1 S/m² on 800 mm²
    800 µS
    """

    vertices: Float[Array, "n 2"]
    conductance: Float[Array, ""]

    def __init__(self, vertices: Numbers, conductance: Numbers):
        self.vertices = float_array("vertices", vertices)
        require_shape("vertices", self.vertices, (None, 2))
        require(len(self.vertices) >= 3, "vertices", len(self.vertices), "3 or more")
        require_finite("vertices", self.vertices)
        self.conductance = _conductance(conductance)

    def distance(self, points: Points) -> Density:
        start = self.vertices
        end = jnp.roll(start, -1, 0)
        edge, to = end - start, points[..., None, :] - start
        along = (to * edge).sum(-1) / (edge**2).sum(-1)
        nearest = _length(to - jnp.clip(along, 0, 1)[..., None] * edge).min(-1)
        # Even-odd rule: edges that a ray along +x crosses.
        x, y = points[..., None, 0], points[..., None, 1]
        spans = (start[:, 1] > y) != (end[:, 1] > y)
        rise = jnp.where(edge[:, 1] == 0, 1, edge[:, 1])
        crossing = start[:, 0] + (y - start[:, 1]) / rise * edge[:, 0]
        inside = (spans & (x < crossing)).sum(-1) % 2 == 1
        return jnp.where(inside, -nearest, nearest)
