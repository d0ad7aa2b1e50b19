"""Defines shapes that touch the sheet: an outline each, and the conductance inside."""

from dataclasses import replace
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax._checks import checked, checking, require, require_array
from tomojax._custom_types import Numbers
from tomojax.sensor._edges import polygon_distance
from tomojax.sensor._outline import (
    AbstractOutline,
    checked_angle,
    checked_center,
    checked_conductance,
    Density,
    norm,
    Points,
    turned,
)

Outline = TypeVar("Outline", bound=AbstractOutline)


def _of_total(shape: Outline, siemens: Numbers, area: Array) -> Outline:
    """Returns the shape with so many siemens spread over its area, m²."""
    total = checked("siemens", siemens, "not negative", ())
    return replace(shape, conductance=total / area.astype(total.dtype))


class Disc(AbstractOutline):
    """A round contact: `center` (2,) m, `radius` m, `conductance` S/m².

    `conductance` counts per area: a disc of 6 mm and 0.5 S/m² conducts 57 µS in all.
    `Disc.of_total` takes the whole conductance in S, as `simulate_scenes` and results have
    it. A mesh holds that total to 2 % for a radius of one cell, to 1 % from two cells on.

    **Example:**

    >>> import tomojax as tx
    >>> disc = tx.Disc([0.03, 0.05], radius=0.006, conductance=0.5)
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, disc).sum()
    >>> print(f"{1e6 * float(siemens):.0f} µS")  # 0.5 S/m² on π·(6 mm)²
    57 µS
    >>> total = tx.Disc.of_total([0.03, 0.05], radius=0.006, siemens=57e-6)
    >>> print(f"{float(total.conductance):.2f} S/m²")
    0.50 S/m²
    """

    center: Float[Array, "2"] = eqx.field(converter=checked_center)
    radius: Float[Array, ""] = eqx.field(converter=checking("radius", "positive", ()))
    conductance: Float[Array, ""] = eqx.field(converter=checked_conductance)

    @classmethod
    def of_total(cls, center: Numbers, radius: Numbers, siemens: Numbers) -> "Disc":
        """Makes a disc that conducts so many `siemens` in all."""
        disc = cls(center, radius, 1.0)
        return _of_total(disc, siemens, np.pi * disc.radius**2)

    def distance(self, points: Points) -> Density:
        return norm(points - self.center) - self.radius


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

    center: Float[Array, "2"] = eqx.field(converter=checked_center)
    semi_axes: Float[Array, "2"] = eqx.field(
        converter=checking("semi_axes", "positive", (2,))
    )
    angle: Float[Array, ""] = eqx.field(converter=checked_angle)
    conductance: Float[Array, ""] = eqx.field(converter=checked_conductance)

    @classmethod
    def of_total(
        cls, center: Numbers, semi_axes: Numbers, angle: Numbers, siemens: Numbers
    ) -> "Ellipse":
        """Makes an ellipse that conducts so many `siemens` in all, as `Disc.of_total`."""
        ellipse = cls(center, semi_axes, angle, 1.0)
        return _of_total(ellipse, siemens, np.pi * ellipse.semi_axes.prod())

    def distance(self, points: Points) -> Density:
        # First order in the distance, exact on the outline: all that `density` uses.
        local = turned(points, self.center, self.angle)
        scaled = norm(local / self.semi_axes)
        slope = norm(local / self.semi_axes**2)
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

    center: Float[Array, "2"] = eqx.field(converter=checked_center)
    length: Float[Array, ""] = eqx.field(converter=checking("length", "positive", ()))
    width: Float[Array, ""] = eqx.field(converter=checking("width", "positive", ()))
    angle: Float[Array, ""] = eqx.field(converter=checked_angle)
    conductance: Float[Array, ""] = eqx.field(converter=checked_conductance)

    @classmethod
    def of_total(
        cls,
        center: Numbers,
        length: Numbers,
        width: Numbers,
        angle: Numbers,
        siemens: Numbers,
    ) -> "Bar":
        """Makes a bar that conducts so many `siemens` in all, as `Disc.of_total`."""
        bar = cls(center, length, width, angle, 1.0)
        return _of_total(bar, siemens, bar.length * bar.width)

    def distance(self, points: Points) -> Density:
        local = turned(points, self.center, self.angle)
        beyond = jnp.abs(local) - jnp.stack([self.length, self.width]) / 2
        return norm(jnp.maximum(beyond, 0)) + jnp.minimum(beyond.max(-1), 0)


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

    center: Float[Array, "2"] = eqx.field(converter=checked_center)
    inner: Float[Array, ""] = eqx.field(converter=checking("inner", "positive", ()))
    outer: Float[Array, ""] = eqx.field(converter=checking("outer", "positive", ()))
    conductance: Float[Array, ""] = eqx.field(converter=checked_conductance)

    def __check_init__(self) -> None:
        require_array("outer − inner", self.outer - self.inner, "positive")

    @classmethod
    def of_total(
        cls, center: Numbers, inner: Numbers, outer: Numbers, siemens: Numbers
    ) -> "Ring":
        """Makes a ring that conducts so many `siemens` in all, as `Disc.of_total`."""
        ring = cls(center, inner, outer, 1.0)
        return _of_total(ring, siemens, np.pi * (ring.outer**2 - ring.inner**2))

    def distance(self, points: Points) -> Density:
        radius = norm(points - self.center)
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

    vertices: Float[Array, "n 2"] = eqx.field(
        converter=checking("vertices", "finite", (None, 2))
    )
    conductance: Float[Array, ""] = eqx.field(converter=checked_conductance)

    def __check_init__(self) -> None:
        require(len(self.vertices) >= 3, "vertices", len(self.vertices), "3 or more")

    def distance(self, points: Points) -> Density:
        return polygon_distance(points, self.vertices, jnp.roll(self.vertices, -1, 0))
