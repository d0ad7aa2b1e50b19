"""Places presses by a response, frame by frame, as one compiled program."""

from typing import Any, NamedTuple, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Integer

from tomojax._programs import kept
from tomojax._require import require
from tomojax.ert._learning import by_columns, Posterior, posterior
from tomojax.kernels.algebra import matmul
from tomojax.kernels.flags import Flag
from tomojax.kernels.inverse import matern

if TYPE_CHECKING:
    from tomojax.ert._response import Response

HIDDEN = 20  # known places that judge a map: a share of 68 % of 20 is known to 10 %
LEAST_KNOWN = 2 * HIDDEN
QUIET = 0.25  # of a usual press's strength: nothing presses
_STRENGTHS = (0.5, 0.7, 1.4, 2.0)  # of a press, tried where none of the usual one fits
# Two presses are tried on a tenth of the candidates' extent, at these strengths: halves, so
# that what one press explains two explain about as well, and no strength tells them apart.
_COARSE = 10
_BOTH = ((1.0, 1.0), (0.5, 0.5), (1.0, 0.5), (0.5, 1.0))


class Located(NamedTuple):
    """Places of n frames, m, as the recording has them; JAX arrays of one by a `Locator`.

    **Example:**

    >>> import tomojax as tx
    >>> tx.ert.Located._fields
    ('xy', 'covariance', 'strength', 'residual', 'flags')
    """

    xy: Float[np.ndarray, "*n 2"]
    covariance: Float[np.ndarray, "*n 2 2"]  # m²
    strength: Float[np.ndarray, "*n"]  # of the press, over the usual press's there
    residual: Float[np.ndarray, "*n"]  # rms, in deviations of the readings
    flags: Integer[np.ndarray, "*n"]  # bits of `Flag`


class _Map(NamedTuple):
    """Readings of presses, whitened by the errors."""

    readings: Float[Array, "m K"]
    squares: Float[Array, " m"]  # of their norms

    def chi2(self, white: Float[Array, "n K"]) -> Float[Array, "n m"]:
        """Returns the squared distances of whitened readings to the map's."""
        squares = jnp.sum(white**2, 1)[:, None] - 2 * matmul(white, self.readings.T)
        return jnp.maximum(squares + self.squares, 0)


class _Maps(NamedTuple):
    usual: _Map  # lone presses of the usual strength
    lone: _Map  # of other strengths
    both: _Map  # two at once


class Locator(eqx.Module):
    """A response made ready for frames: a pure function from readings to a place.

    `locator(voltages)` takes one frame (C, R), V, and answers `Located` as
    `Response.locate` does; `eqx.filter_jit`, `jax.vmap` and `jax.grad` work on it. Tables
    are whitened beforehand, so that a frame costs a product with them.

    **Example:**

    >>> import equinox as eqx
    >>> import numpy as np
    >>> import tomojax as tx
    >>> one = tx.ert.Response(
    ...     at=np.array([[0.0, 0.0], [0.01, 0.0]]),
    ...     readings=np.array([[1.0, 0.1, 0.2], [0.1, 1.0, 0.2]]),
    ...     spread=np.zeros(2),
    ...     whitener=100 * np.eye(3),
    ...     scale=np.ones(3),
    ...     limit=4.0,
    ...     own=0.001,
    ...     known=100,
    ... )
    >>> locate = eqx.filter_jit(tx.ert.Locator(one))
    >>> print(np.round(1e3 * locate(2 * np.sinh(one.readings[1:])).xy))  # mm
    [10.  0.]
    """

    _at: Float[Array, "G 2"]
    _readings: Float[Array, "G K"]
    _spread: Float[Array, " G"]
    _whitener: Float[Array, "K K"]
    _maps: _Maps | None  # None: by the physics
    _scale: Float[Array, " K"]
    _used: Integer[np.ndarray, " K"]
    _taught: tuple[Float[Array, "M K"], Float[Array, "M 2"], Float[Array, ""]] | None
    _limit: Float[Array, ""]
    _alone: Float[Array, ""]
    _own: Float[Array, ""]
    _share: Float[Array, ""]
    _uncertain: bool = eqx.field(static=True)

    def __init__(self, response: "Response"):
        dtype = jnp.asarray(response.at).dtype
        named = "at", "readings", "spread", "whitener", "limit", "alone", "own", "share"
        for name in named:
            setattr(self, f"_{name}", jnp.asarray(getattr(response, name), dtype))
        self._used = np.flatnonzero(response.used)
        self._scale = jnp.asarray(response.scale[self._used], dtype)
        taught = response.taught, response.weights, response.reach
        self._taught = None
        if response.taught is not None:
            self._taught = tuple(jnp.asarray(one, dtype) for one in taught)  # pyright: ignore
        self._uncertain = response.known < LEAST_KNOWN
        self._maps = None
        if response.known >= 0:
            one, other = _pairs_apart(np.asarray(response.at))
            self._maps = _whitened(self._readings, self._whitener, one, other)

    def __call__(self, voltages: Float[Array, "C R"]) -> Located:
        """Places the press of one frame."""
        found, _ = self.frames(jnp.reshape(jnp.asarray(voltages), (1, -1)))
        return jax.tree.map(lambda field: field[0], found)

    def frames(self, flat: Float[Array, "n N"]) -> tuple[Located, Float[Array, " n"]]:
        """Places n frames; and returns log(χ² by one press / χ² by two) of each."""
        flat = jnp.asarray(flat, self._at.dtype)
        values = flat[:, self._used] / self._scale
        missing = ~jnp.isfinite(values)
        values = jnp.where(missing, 0, values)
        placed = self._placed(values)

        def filled() -> tuple:
            """A reading that is missing is as the press there has it."""
            found, strength = placed
            usual = strength[:, None] * self._usual(found)
            new = jnp.where(missing, usual, values)
            return new, self._placed(new)

        values, (found, strength) = lax.cond(
            missing.any(), filled, lambda: (values, placed)
        )
        gain = self._gain_of_two(values)
        flags = jnp.zeros(len(flat), jnp.uint32)
        for flag, told in (
            (Flag.HIGH_RESIDUAL, (found.chi2 > self._limit) | (gain > self._alone)),
            (Flag.NO_CONTACT, strength < QUIET),
            (Flag.PLACE_UNCERTAIN, jnp.full(len(flat), self._uncertain)),
            (Flag.DEAD_CHANNEL, missing.any(1)),
            (Flag.NO_DATA, missing.mean(1) > 0.5),
        ):
            flags = flags | jnp.where(told, jnp.uint32(flag.value), jnp.uint32(0))
        own = self._own**2 * jnp.eye(2, dtype=self._at.dtype)
        covariance = self._share**2 * found.covariance + own
        residual = jnp.sqrt(found.chi2)
        told: Any = found.xy, covariance, strength, residual, flags
        return Located(*told), gain

    def _placed(self, values: Float[Array, "n K"]) -> tuple[Posterior, Float[Array, " n"]]:
        if self._maps is None:
            size = jnp.sqrt(jnp.sum(values**2, 1, keepdims=True))
            unit = values / jnp.where(size > 0, size, 1)
            found, strength = by_columns(unit, self._readings, self._whitener, self._at)
            return found, jnp.where(strength > 0, size, 0)[:, 0]
        found = self._by_map(values, self._maps.usual)
        usual = self._usual(found)
        product = jnp.sum(values * usual, 1)
        return found, product / jnp.maximum(jnp.sum(usual**2, 1), 1e-30)

    def _by_map(self, values: Float[Array, "n K"], maps: _Map) -> Posterior:
        """Places presses of the usual strength, or of the one that fits where none does."""
        read = jnp.stack([jnp.arcsinh(values / (2 * each)) for each in (1.0, *_STRENGTHS)])
        by_strength = jax.vmap(lambda y: matmul(y, self._whitener.T))(read)
        wide = 1 + self._spread
        chi2 = jax.vmap(maps.chi2)(by_strength) / wide
        scores = -0.5 * (chi2 + read.shape[2] * jnp.log(wide))
        best = jnp.argmax(scores, 2)
        least = jnp.take_along_axis(chi2, best[..., None], 2)[..., 0] / read.shape[2]
        which = jnp.where(least[0] > self._limit, jnp.argmin(least, 0), 0)
        scores, chi2, read = (
            jnp.take_along_axis(a, which[None, :, None], 0)[0] for a in (scores, chi2, read)
        )
        found = posterior(scores, chi2 / read.shape[1], self._at)
        if self._taught is None:
            return found
        taught, weights, reach = self._taught
        return found._replace(xy=found.xy - matern(read, taught, reach) @ weights)

    def _usual(self, found: Posterior) -> Float[Array, "n K"]:
        """Returns the readings of presses of the usual strength at the found places."""
        mapped = self._readings[found.best]
        if self._maps is None:
            return mapped / jnp.linalg.norm(mapped, axis=1, keepdims=True)
        return 2 * jnp.sinh(mapped)

    def _gain_of_two(self, values: Float[Array, "n K"]) -> Float[Array, " n"]:
        """Returns log(χ² by one press / χ² by two), each the least; 0 by the physics."""
        if self._maps is None or not len(self._maps.both.squares):
            return jnp.zeros(len(values), values.dtype)
        white = matmul(jnp.arcsinh(values / 2), self._whitener.T)
        usual, other, two = (one.chi2(white).min(1) for one in self._maps)
        by_one, by_two = jnp.minimum(usual, other), two
        return jnp.log(jnp.maximum(by_one, 1e-30)) - jnp.log(jnp.maximum(by_two, 1e-30))


@kept
def _located(
    locator: Locator, flat: Float[Array, "n N"]
) -> tuple[Located, Float[Array, " n"]]:
    return locator.frames(flat)


def locate(
    locator: Locator, voltages: Float[np.ndarray, "n C R"], readings: int, most: int = 256
) -> tuple[Located, Float[np.ndarray, " n"]]:
    """Places frames on the host, `most` at a time; returns `Locator.frames`' of all.

    **Raises:** `ValueError` for readings that are not the response's.
    """
    flat = np.asarray(voltages, float).reshape(len(voltages), -1)
    require(flat.shape[1] == readings, "v", f"{flat.shape[1]} a frame", f"{readings}")
    # Few sizes, and so few programs: a power of two, and many at a time.
    some = min(most, 1 << max(len(flat) - 1, 0).bit_length())
    parts = []
    for first in range(0, max(len(flat), 1), some):
        part = flat[first : first + some]
        padded = np.pad(part, ((0, some - len(part)), (0, 0)))
        padded = jnp.asarray(padded, locator._at.dtype)
        found = _located(locator, padded)
        parts.append(jax.tree.map(lambda a: np.asarray(a)[: len(part)], found))  # noqa: B023
    located, gain = jax.tree.map(lambda *each: np.concatenate(each), *parts)
    exact = {name: getattr(located, name).astype(float) for name in Located._fields[:-1]}
    return located._replace(**exact), gain.astype(float)


@kept
def _whitened(
    readings: Float[Array, "G K"],
    whitener: Float[Array, "K K"],
    one: Integer[Array, " p"],
    other: Integer[Array, " p"],
) -> _Maps:
    """Whitens readings of lone presses, and of two, whose readings add up."""
    raw = jnp.sinh(readings)
    lone = [jnp.arcsinh(each * raw) for each in _STRENGTHS]
    both = [jnp.arcsinh(a * raw[one] + b * raw[other]) for a, b in _BOTH]

    def white(*mapped: Float[Array, "m K"]) -> _Map:
        found = matmul(jnp.concatenate(mapped), whitener.T)
        return _Map(found, jnp.sum(found**2, 1))

    return _Maps(white(readings), white(*lone), white(*both))


def _pairs_apart(at: Float[np.ndarray, "G 2"]) -> Integer[np.ndarray, "2 p"]:
    """Returns pairs of some candidates that are not beside each other."""
    step = np.ptp(at, 0).max() / _COARSE + 1e-12
    cells = np.floor((at - at.min(0)) / step)
    few = np.unique(cells, axis=0, return_index=True)[1]
    apart = np.abs(cells[few][:, None] - cells[few]).max(-1) > 1
    return few[np.array(np.nonzero(np.triu(apart)))]
