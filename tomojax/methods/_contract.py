"""Defines a step of the ladder of models: the contract that each method keeps.

A method prepares once for a set of grounds and of good channels, and then fits many frames.
A new method needs only a file of its own and a line in `METHODS`.
"""

import functools
import operator
from abc import abstractmethod
from enum import IntEnum
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer

from tomojax._checks import known
from tomojax._programs import kept
from tomojax._require import require_memory
from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import Contacts, no_contacts
from tomojax.methods._rows import Rows
from tomojax.sensor import Calibration

# Residual that a converter's noise and zeros may leave in any case, in the noise.
_FLOOR = 2.0

# Voltage that a range that ended has at least, in the noise.
_RANGE = 20.0

# So many channels of a slot, or one in so many, do not share the highest value by chance.
_SHARED = 8


class Rung(IntEnum):
    """The model that a row comes from.

    **Example:**

    >>> import tomojax as tx
    >>> tx.methods.Rung(2).name  # as `rung` of a row of "auto" has it
    'SOURCE'
    """

    NOTHING = 0
    POINTS = 1
    SOURCE = 2
    CONDUCTANCE = 3  # in files before `shape` took its place
    SHAPE = 4


class Estimate(NamedTuple):
    """A method's results for one frame.

    **Example:**

    >>> import jax
    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = np.asarray(tx.voltages(sensor, touch, [0, 15]))
    >>> lam = method.choose_lambda([])
    >>> prepared = method.prepare(np.array([0, 15]), np.isfinite(volts), lam)
    >>> estimate = jax.jit(lambda v: method.estimate(prepared, v, 1))(volts)
    >>> int(estimate.contacts.count), estimate.image.shape
    (1, (16, 16))
    """

    contacts: Contacts
    image: Float[Array, "nx ny"]
    residual: Float[Array, ""]  # rms over the voltages used, V
    flags: Int[Array, ""] | int = 0  # bits that the method sets
    rung: Int[Array, ""] | int = 0  # of `auto`: which model
    by_electrode: Float[Array, " M"] | None = None  # residual of each, V rms
    touch: Float[Array, "nx ny"] | None = None  # the probability that a pixel touches
    deviation: Float[Array, "nx ny"] | None = None  # of the image


class Frame(NamedTuple):
    """One scan, or one slot of a scan, as measured (NumPy).

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = np.asarray(tx.voltages(sensor, touch, [0, 15]))
    >>> frame = tx.methods.Frame(volts, np.array([0, 15]), np.isfinite(volts))
    >>> method.choose_lambda([frame]) > 0
    True
    """

    voltages: Float[np.ndarray, "S M"]
    grounds: Integer[np.ndarray, " S"]
    good: Bool[np.ndarray, "S M"]


class Part(NamedTuple):
    """The n frames of a batch that a method estimates in one go."""

    voltages: Float[Array, "n S M"]
    grounds: Integer[np.ndarray, "n S"]  # the prepared ones, unless a method takes any
    films: Int[np.ndarray, " n"] | None = None  # of each frame, for a method that `films`


def rms(
    values: Float[Array, "*slots M"], used: Bool[Array, "*slots M"]
) -> Float[Array, ""]:
    """Computes the rms over the voltages that are used; 0 where none are."""
    count = jnp.maximum(used.sum(), 1).astype(values.dtype)
    return jnp.sqrt((jnp.where(used, values, 0) ** 2).sum() / count)


def centred(
    values: Float[Array, "*before M"], used: Bool[Array, "*slots M"]
) -> Float[Array, "*before M"]:
    """Subtracts the mean over the channels that are used; other channels become 0."""
    count = jnp.maximum(used.sum(-1, keepdims=True), 1).astype(values.dtype)
    mean = jnp.where(used, values, 0).sum(-1, keepdims=True) / count
    return jnp.where(used, values - mean, 0)


def bits_of(*told: tuple[Bool[Array, ""], Flag]) -> Int[Array, ""]:
    """Returns the bits of the flags that are on."""
    each = [jnp.where(on, flag.value, 0) for on, flag in told]
    return functools.reduce(operator.or_, each)


def rms_by_electrode(
    misfit: Float[Array, "S M"], used: Bool[Array, "S M"]
) -> Float[Array, " M"]:
    """Computes each electrode's rms over the slots that are used; NaN where none are."""
    return jnp.sqrt(jnp.mean(misfit**2, 0, where=used))


class AbstractMethod(eqx.Module):
    """A method: computes contacts and an image from the voltages of one frame.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> isinstance(method, tx.methods.AbstractMethod)
    True
    >>> method.shape, method.image_unit, method.tells_covariance
    ((16, 16), 'A/m^2', False)
    """

    shape: eqx.AbstractVar[tuple[int, int]]  # pixels of the image
    cell: eqx.AbstractVar[Float[Array, "2"]]  # their size, m
    image_unit: eqx.AbstractClassVar[str]
    # Residual beyond this part of the voltages' rms: the model does not hold.
    residual_limit: eqx.AbstractClassVar[float]
    # Whether contacts come with the covariance of their place.
    tells_covariance: ClassVar[bool] = False
    # Whether it chooses between models.
    tells_rung: ClassVar[bool] = False
    # Whether a call may have frames of different grounds.
    any_grounds: ClassVar[bool] = False
    # Whether frames of a film begin where its first ends.
    films: ClassVar[bool] = False
    # What no channel exceeds without a contact, in the noise.
    stands_out: ClassVar[float] = 11.0
    # How fine a mesh is needed beside the electrodes.
    cells_per_diameter: ClassVar[int] = 1
    # Frames of a compiled call: as many as keep the working set in the cache. What is left
    # of a group fills the smallest that holds it, so that at most three are compiled.
    blocks: ClassVar[tuple[int, ...]] = (32, 256, 1024)
    # About what a slot costs, s, as two cores of 2024 measured it (tests/benchmarks/
    # costs.py). Only the length of a chunk follows from it: a number, and no measurement,
    # as two runs with the same configuration make the same bytes.
    seconds_per_slot: ClassVar[float] = 2e-5
    # Whether a call is filled up to that with zeros; else the method does what it needs.
    padded: ClassVar[bool] = True

    @property
    def electrode_count(self) -> int:
        """Returns M, the number of electrodes; by default that of a field `grounded`."""
        return self.grounded.shape[1]  # pyright: ignore

    @property
    @abstractmethod
    def drive_sign(self) -> Float[Array | np.ndarray, ""]:
        """Returns the drive's direction: 1 or −1."""

    @property
    def highest(self) -> Float[Array | np.ndarray, ""] | float:
        """Returns the |V| that the drive cannot exceed; by default nothing tells it."""
        return np.inf

    @property
    @abstractmethod
    def noise(self) -> Float[Array, ""]:
        """Returns the noise of a reading, V rms."""

    @property
    def threshold(self) -> Float[Array | np.ndarray, ""]:
        """Returns volts that no channel exceeds without a contact; skips lower frames."""
        noise = self.noise
        if not known(noise):
            return self.stands_out * noise
        return np.asarray(self.stands_out * np.asarray(noise))  # JAX would compile this

    def sizes(self, contacts: int, images: bool) -> dict[str, int]:
        """Returns the sizes of a row's fields, by the sizes' names in `Rows`."""
        if not images:
            return {"C": contacts}
        nx, ny = self.shape
        return {"C": contacts, "nx": nx, "ny": ny, "M": self.electrode_count}

    def calibrated(self, calibration: Calibration) -> "AbstractMethod":
        """Returns the method with a calibration's noise and model error, where used."""
        return self

    def choose_lambda(self, frames: list[Frame]) -> float:
        """Chooses λ for a recording, from a few of its frames with a contact.

        λ = 1 is the error of a sheet with nominal values, for methods that model errors.
        """
        return 1.0

    def scale(self) -> float:
        """Returns σ₁², to which λ is relative."""
        return 1.0

    @abstractmethod
    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> Any:
        """Prepares arrays for all frames with these grounds (S,) and good channels (S, M).

        A slot without a good channel is not used. This is host code, in float64.
        """

    def prepare_each(self, good: Bool[np.ndarray, " M"], lam: float) -> list[Any]:
        """Prepares for a slot of each ground; an array that is in all is shared."""
        grounds = np.arange(len(grounded_of(self)))[:, None]
        first = self.prepare(grounds[0], good[None], lam)
        held = len(grounds) * sum(a.nbytes for a in jax.tree.leaves(first))
        require_memory(held, f"a step of {len(grounds)} grounds")
        return [first, *(self.prepare(ground, good[None], lam) for ground in grounds[1:])]

    @abstractmethod
    def estimate(
        self, prepared: Any, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        """Returns up to `count` contacts, an image and a residual of one frame. Compiled.

        Channels that are not good come as 0.
        """

    def block(self, prepared: Any, part: Part, count: int, images: bool) -> Rows:
        """Estimates n frames, `judged`; a method may need several calls."""
        return _block(self, prepared, part.voltages, count, images)


@kept
def _block(
    method: AbstractMethod,
    prepared: Any,
    voltages: Float[Array, "n S M"],
    count: int,
    images: bool,
) -> Rows:
    def one(v: Float[Array, "S M"]) -> Rows:
        return judged(method, method.estimate(prepared, v, count), v, images)

    return jax.vmap(one)(voltages)


def inside_of(method: AbstractMethod) -> Bool[Array, "nx ny"] | None:
    """Returns which pixels have some of the sheet, a field `inside`; None: every pixel.

    The image is NaN in all others.
    """
    return getattr(method, "inside", None)


def masked(method: AbstractMethod, image: Float[Array, "nx ny"]) -> Float[Array, "nx ny"]:
    """Returns an image of the method's, NaN where no sheet is."""
    inside = inside_of(method)
    return image if inside is None else jnp.where(inside, image, jnp.nan)


def grounded_of(method: AbstractMethod) -> Bool[np.ndarray, "L M"]:
    """Returns the electrodes of each ground that tell of their path alone.

    That is a field `grounded`; by default each electrode is grounded alone.
    """
    told = getattr(method, "grounded", None)
    return np.eye(method.electrode_count, dtype=bool) if told is None else told


def highest_of(volts: Float[Array, ""]) -> Float[Array | np.ndarray, ""]:
    """Returns the |V| that no reading exceeds, with a drive that is told to 5 %."""
    if not known(volts):
        return 1.05 * jnp.abs(volts)
    return np.asarray(1.05 * abs(np.asarray(volts)))


def sign_of(volts: Float[Array, ""]) -> Float[Array | np.ndarray, ""]:
    """Returns the sign of a drive voltage."""
    return np.asarray(np.sign(np.asarray(volts))) if known(volts) else jnp.sign(volts)


def judged(
    method: AbstractMethod,
    estimate: Estimate,
    voltages: Float[Array, "S M"],
    images: bool,
) -> Rows:
    """Makes a row of results, with images or without."""
    residual = estimate.residual
    contacts, flags = judge(
        estimate.contacts,
        residual,
        estimate.flags,
        voltages,
        method.residual_limit,
        method.noise,
    )

    def drawn(image: Array | None) -> Array | None:
        return None if image is None or not images else masked(method, image)

    return Rows.of(
        contacts,
        residual=residual,
        flags=flags,
        rung=jnp.asarray(estimate.rung, jnp.uint8),
        image=drawn(estimate.image),
        residual_by_electrode=estimate.by_electrode if images else None,
        touch=drawn(estimate.touch),
        image_deviation=drawn(estimate.deviation),
    )


def judge(
    contacts: Contacts,
    residual: Float[Array, ""],
    flags: Int[Array, ""] | int,
    voltages: Float[Array, "*slots M"],
    limit: float,
    noise: Float[Array, ""],
) -> tuple[Contacts, Int[Array, ""]]:
    """Returns contacts and flags; a frame whose residual is no number has no contact.

    `limit`: the part of the voltages' rms beyond which a residual is high; `noise` of a
    reading, V.
    """
    failed = ~jnp.isfinite(residual)
    # A channel that is not good is 0: the limit is the lower for it.
    high = residual > limit * jnp.sqrt(jnp.mean(voltages**2)) + _FLOOR * noise
    none = no_contacts(len(contacts.radius), voltages.dtype)
    contacts = tree_where(failed, none, contacts)
    flags = jnp.where(failed, Flag.SOLVE_FAILED.value, flags)
    nothing = contacts.count == 0
    # A row without a contact has no place that could be uncertain.
    flags = jnp.where(nothing, flags & ~Flag.PLACE_UNCERTAIN.value, flags)
    found = bits_of(
        (high, Flag.HIGH_RESIDUAL),
        (cut_off(voltages, noise), Flag.SATURATED),
        (nothing, Flag.NO_CONTACT),
    )
    return contacts, flags | found


def cut_off(voltages: Float[Array, "*slots M"], noise: Float[Array, ""]) -> Bool[Array, ""]:
    """Tells whether many channels of a slot share the highest value: the range ended there.

    This serves a converter whose rails nobody told. An eighth of the channels do not read
    the same by chance, if they read more than a few of the converter's steps.
    """
    size = jnp.abs(voltages)
    highest = size.max(-1, keepdims=True)
    shared = (size == highest).sum(-1)
    many = max(_SHARED, voltages.shape[-1] // _SHARED)
    return ((shared > many) & (highest[..., 0] > _RANGE * noise)).any()
