"""Follows values that drift: a Kalman filter of value and rate for each channel."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# A rate lasts for so many hours.
_LASTS = 3.0

# A value walks at random beside its rate, by this part of it.
_WALK = 0.1

# A rate beyond so many σ is not believed.
_STEEPEST = 3.0

# A measurement that is off by more than so many σ counts as that.
_OUTLYING = 3.0


class Drift(NamedTuple):
    """Values that drift, a channel each: a Kalman filter of value and rate."""

    value: Float[np.ndarray, " M"]
    rate: Float[np.ndarray, " M"]  # an hour
    variance: Float[np.ndarray, " M"]  # of the value
    both: Float[np.ndarray, " M"]  # covariance with the rate
    of_rate: Float[np.ndarray, " M"]
    usual: Float[np.ndarray, " M"]  # the value's mean of the last hour

    @classmethod
    def of(cls, variance: Float[np.ndarray, " M"], rate: float, age: float) -> "Drift":
        """Begins at 0, as well known as `variance` says, `age` hours ago."""
        none = 0 * variance
        older = variance + (rate * age) ** 2
        return cls(none, none, older, none, none + rate**2, none)

    def later(self, hours: float, rate: float) -> "Drift":
        """Moves some hours on: the rate goes on for a while, and less is known.

        A rate lasts τ hours, dr = −r/τ dt + noise. The value is the rate's integral beside
        a walk.
        """
        if hours <= 0:
            return self
        kept, lasts = np.exp(-hours / _LASTS), _LASTS
        reach = lasts * (1 - kept)
        far = rate**2 * lasts**2 * (2 * hours / lasts - 3 + 4 * kept - kept**2)
        walked = (_WALK * rate) ** 2 * hours
        usual = self.usual + (self.value - self.usual) * -np.expm1(-hours)
        variance = self.variance + 2 * reach * self.both + reach**2 * self.of_rate
        both = kept * (self.both + reach * self.of_rate) + rate**2 * reach**2 / lasts
        return Drift(
            self.value + reach * self.rate,
            kept * self.rate,
            variance + max(far, 0.0) + walked,
            both,
            kept**2 * self.of_rate + rate**2 * (1 - kept**2),
            usual,
        )

    def widened(self, off: np.ndarray, variance: np.ndarray) -> "Drift":
        """Knows less where channels together are off by more than is believed.

        Drift has no rate of its own: what all channels' measurements say of it counts.
        """
        whole = self.variance + variance
        told = np.isfinite(whole)
        more = np.mean((off**2 - whole)[told]) if 2 * told.sum() > len(told) else 0.0
        return self._replace(variance=self.variance + max(0.0, float(more)))

    def told(self, off: np.ndarray, variance: np.ndarray) -> "Drift":
        """Takes in a measurement that is `off`; `variance` is ∞ where there is none."""
        whole = self.variance + variance
        limit = _OUTLYING * np.sqrt(np.where(np.isfinite(whole), whole, 0))
        off = np.clip(off, -limit, limit)
        part, turn = self.variance / whole, self.both / whole
        return self._replace(
            value=self.value + part * off,
            rate=self.rate + turn * off,
            variance=(1 - part) * self.variance,
            both=(1 - part) * self.both,
            of_rate=self.of_rate - turn * self.both,
        )

    def bounded(self, rate: float, most: float, near: float) -> "Drift":
        """Clips value and rate to what is believed; `near` its mean of the last hour."""
        steep = _STEEPEST * rate
        value = np.clip(self.value, self.usual - near, self.usual + near)
        value = np.clip(value, -most, most)
        # After a long gap much could be: what is off by more than a third is still odd.
        less = np.minimum(1, (most / 3) ** 2 / self.variance)
        return self._replace(
            value=value,
            rate=np.clip(self.rate, -steep, steep),
            variance=less * self.variance,
            both=np.sqrt(less) * self.both,
        )
