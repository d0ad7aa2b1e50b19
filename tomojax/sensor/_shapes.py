"""What touches the sheet: shapes with a conductance per area, at rest or moving.

A shape gives the conductance per area (S/m²) at any point of the sheet. Outlines are
signed distances (negative inside); across an outline the conductance falls over the
distance between two sample points, so that it is smooth in the shape's place and size.
"""

from abc import abstractmethod

import equinox as eqx
import jax
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
    """A contact."""

    @abstractmethod
    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        """Conductance per area (S/m²) at `points` (m) on a sheet of `size` (m)."""


class AbstractOutline(AbstractShape):
    """A contact of even conductance inside an outline."""

    conductance: eqx.AbstractVar[Float[Array, ""]]

    @abstractmethod
    def distance(self, points: Points) -> Density:
        """Distance to the outline, m, negative inside."""

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        inside = jnp.clip(0.5 - self.distance(points) / blur, 0, 1)
        return self.conductance * inside**2 * (3 - 2 * inside)


def _length(vector: Float[Array, "*points 2"]) -> Density:
    """|v| with a zero gradient at v = 0, where jnp.linalg.norm has NaN."""
    square = (vector**2).sum(-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _turned(points: Points, center: Array, angle: Array) -> Points:
    """`points` in axes at `center`, turned by `angle`."""
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
    """A round contact: `center` (2,) m, `radius` m, `conductance` S/m²."""

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
    """`semi_axes` (2,) m, the first turned by `angle` (rad) from the x axis."""

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
    """A rectangle, `length` m along `angle` (rad) from the x axis and `width` m across."""

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
    """A rim between the radii `inner` and `outer`, m."""

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
    """`vertices` (n, 2) m in order around the outline, either way round."""

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


class Mask(AbstractShape):
    """Any contact: conductance per area (nx, ny), S/m², on even cells over the sheet."""

    conductance: Float[Array, "nx ny"]

    def __init__(self, conductance: Numbers):
        self.conductance = float_array("conductance", conductance)
        require_shape("conductance", self.conductance, (None, None))
        require_not_negative("conductance", self.conductance)

    def density(
        self, points: Points, blur: Float[Array, ""], size: Float[Array, "2"]
    ) -> Density:
        cells = jnp.array(self.conductance.shape)
        index = jnp.floor(points / size * cells.astype(size.dtype)).astype(int)
        on_sheet = ((index >= 0) & (index < cells)).all(-1)
        i, j = jnp.moveaxis(jnp.clip(index, 0, cells - 1), -1, 0)
        return jnp.where(on_sheet, self.conductance[i, j], 0)


class Scene(AbstractShape):
    """Several contacts on the sheet at once; none is an untouched sheet."""

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


class Shifted(AbstractShape):
    """A shape displaced by `offset` (2,) m, its conductance times `factor`."""

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
    the shape stands; `factors` (n,) on its conductance. Calling it with a time gives
    the shape then; any function of time that returns a shape does as well.
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
        self.times = float_array("times", times)
        require_shape("times", self.times, (None,))
        require_finite("times", self.times)
        require_positive("steps between times", self.times[1:] - self.times[:-1])
        self.offsets = float_array("offsets", offsets)
        require_shape("offsets", self.offsets, (len(self.times), 2))
        require_finite("offsets", self.offsets)
        given = float_array("factors", factors)
        require_shape("factors", given, (), self.times.shape)
        require_not_negative("factors", given)
        self.factors = jnp.broadcast_to(given, self.times.shape)

    def __call__(self, time: Float[Array, ""]) -> Shifted:
        at = lambda values: jnp.interp(time, self.times, values)  # noqa: E731
        offset = jax.vmap(at, 1)(self.offsets)
        return Shifted(self.shape, offset, at(self.factors))
