"""Contacts on the sheet: ellipses with a pressure profile, of any conductance."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

Profile = Literal["flat", "hertz", "soft", "lopsided"]


class Touch(NamedTuple):
    """An ellipse that conducts; `series` is a resistance from the drive to the ellipse."""

    xy: Float[np.ndarray, "2"]  # of the ellipse's centre, m
    half_axes: tuple[float, float]  # m
    angle: float  # of the first of them, rad
    conductance: float  # in all, S
    profile: Profile = "flat"
    series: float = 0.0  # Ω
    exponent: float = 1.0  # of the law: a current of g (V0 − u) |(V0 − u)/V0|ⁿ⁻¹

    def density(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Returns the conductance per area at points, relative: 0 outside.

        "hertz" is √(1 − r²), the pressure of a sphere; "soft" is (1 − r²)². "lopsided"
        rises ninefold from one end to the other.
        """
        c, s = np.cos(self.angle), np.sin(self.angle)
        along = (points - self.xy) @ np.array([[c, -s], [s, c]]) / np.array(self.half_axes)
        square = (along**2).sum(1)
        left = np.maximum(1 - square, 0)
        inside = (square < 1).astype(float)
        profiles = {
            "flat": inside,
            "hertz": np.sqrt(left),
            "soft": left**2,
            "lopsided": inside * (1 + 0.8 * along[:, 0]),
        }
        return profiles[self.profile]

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """The centre of the conductance, m: ∫x·g/∫g."""
        if self.profile != "lopsided":
            return self.xy
        along = np.array([np.cos(self.angle), np.sin(self.angle)])
        return self.xy + 0.8 / 4 * self.half_axes[0] * along
