"""`linear`: the paper's Eq. 3 with J(0), slot by slot, prepared once for a ground set.

Three changes of the plain form (`tomojax.reconstruct`) place contacts as well as Eq. 3 can;
tests/benchmarks/equation3.py has the gain of each. A slot's level is left out, as ground
paths are hardly known. Each slot has an image of its own, and the image is their mean, as
strong contacts draw another current in every slot. Places are read off pixels that are
divided by their resolution (sLORETA: Pascual-Marqui, 2002), as J's columns are longest at
electrodes.
"""

from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax._require import require_memory
from tomojax.kernels.algebra import matmul
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import (
    Contacts,
    explained,
    highest_place,
    point_sources,
    read_contacts,
    strongest_first,
)
from tomojax.kernels.sheet import contact_jacobian, Resistances, Slots
from tomojax.methods._contract import (
    AbstractMethod,
    bits_of,
    centred,
    Estimate,
    Frame,
    highest_of,
)
from tomojax.methods._errors import noise_as
from tomojax.methods._maps import (
    centring,
    factors_of,
    Pixels,
    pixels_of,
    Shared,
    shared_maps,
    slots_left,
    tikhonov_operator,
)
from tomojax.paper import reduce_jacobian
from tomojax.sensor import Calibration, nominal_noise, resistances, Sensor

# Cells of an electrode's diameter, on the mesh of a sheet that is no rectangle.
_CELLS = 3

# Rows of the basis that stands for J, for each electrode: an image differs by 7e-3 down to
# λ/σ₁² of 1e-6 (see `reduce_jacobian`; 64 electrodes).
_RANK = 4

# Rows that are used from this λ/σ₁² on: an image then differs by 5e-3.
_FEWER = 2
_FROM = 1e-3

# Rows of the basis that stands for the images which tell places, for each electrode: places
# differ by a tenth of a millimetre.
_PLACING_RANK = 5

# λ/σ₁² of these images, σ₁ of each slot. With less, large contacts and rigs with few
# channels are lost; with more, places from few slots are less near. A ratio, of no one rig.
_PLACING = 0.3

# A pixel whose resolution is less than this part of the highest is at the ground: its
# column points anywhere.
_LOW = 1e-5

# A lone contact's place is read from this part of a pitch around its peak.
_NEAR = 0.75

# What the contacts leave of the slots' voltages, each slot with currents of its own and
# without its mean.
_UNEXPLAINED = 0.09

# Slots that are looked at for that.
_SOME = 8

# λ/σ₁² below which an image in float32 is another than in float64, by 20 mm in one of ten.
_SMALLEST = 1e-6

# λ/σ₁² that tells contacts from 60 mm on apart, and leaves a bar of 75 mm one contact, on
# simulated rigs.
_RELATIVE = 3e-3


class PreparedLinear(NamedTuple):
    """Arrays for one ground set with its good channels."""

    image: tuple[Array, ...]  # these in turn turn voltages (SM,) into φ (pixels,)
    placing: tuple[Array, ...]  # and into the image that tells a lone contact's place
    sharp: Float[Array, " pixels"]  # 1/√(diagonal of the resolution matrix)
    rows: Float[Array, "some M r"]  # centred J of the slots that are looked at
    looked: Bool[Array, "some M"]  # their channels, less the ground's
    misfits: Float[Array, "S M M"]  # J A − I on the good channels
    current: Float[Array, "1 pixels"]  # A per volt of φ, the mean over the slots
    used: Bool[Array, "S M"]
    small: Bool[Array, ""]  # whether λ is less than numbers and basis hold


class Linear(AbstractMethod):
    """φ = mean over slots of (JᵀJ + λI)⁻¹JᵀV with J(0), each slot less its mean.

    Contacts are peaks of φ_k/√(resolution matrix)_kk. A lone contact's place is that of the
    highest Σ_l φ^l_k/√(resolution matrix)^l_kk, λ/σ₁² = 0.3: it is highest at the place
    itself, whatever current the contact draws in each slot.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "linear", grid=16)
    >>> isinstance(method, tx.methods.Linear), method.image_unit
    (True, 'V')
    """

    image_unit: ClassVar[str] = "V"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore

    shape: tuple[int, int] = eqx.field(static=True)
    reach: tuple[int, int] = eqx.field(static=True)  # pixels around a peak that tell it
    cell: Float[Array, "2"]
    basis: Float[Array, "r pixels"]
    factors: Float[Array, "L M r"]  # J^l Bᵀ
    strongest: float  # σ₁² of all slots
    shared: Shared  # what all slots' T^l share, host
    standard: Float[np.ndarray, "q pixels"]  # basis of `_standardized`, host
    conductance: Float[Array, "L pixels"]  # of the loop from a pixel to each ground, S
    reading_noise: Float[Array, ""]
    drive: Float[Array, ""]  # V
    grounded: Bool[np.ndarray, "L M"]
    inside: Bool[Array, "nx ny"] | None = None

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Linear":
        """Makes the method for an image of `shape` pixels."""
        # J of all grounds, while the basis is made of it.
        each = len(sensor.all_grounds()) * sensor.electrode_count * shape[0] * shape[1]
        require_memory(3 * each * np.dtype(sensor.dtype).itemsize, "linear")
        # An even rectangle has no mesh error. On one cell an electrode J is highest at the
        # rim, and so are images, wherever the contact is.
        pixels = pixels_of(sensor, shape, 1 if sensor.flat else _CELLS)
        sensor = pixels.sensor
        table = resistances(sensor, "series" if sensor.even else "fem")
        grounds = jnp.asarray(sensor.all_grounds())
        maps, conductance = _pixel_jacobian(
            pixels, table, sensor.slots(table.electrodes), grounds
        )
        rank = min(_RANK * maps.shape[1], maps.shape[0] * maps.shape[1], maps.shape[2])
        reduced = reduce_jacobian(maps, rank)
        # The strongest directions first, so that any number of them is the best choice.
        strength, turn = np.linalg.eigh(np.asarray(reduced.grams, float).sum(0))
        turn = jnp.asarray(turn[:, ::-1].copy(), maps.dtype)
        shared, grounded = shared_maps(pixels)
        good = np.ones(maps.shape[1], bool)
        every = [_standardized(shared, k, good, own) for k, own in enumerate(grounded)]
        standard = _rows_of(np.concatenate(every), _PLACING_RANK * len(good))
        near = _NEAR * sensor.mean_pitch / np.asarray(pixels.cell, float)
        near = np.maximum(1, np.round(near)).astype(int)
        return cls(
            shape=shape,
            reach=(int(near[0]), int(near[1])),
            cell=pixels.cell,
            basis=matmul(turn.T, reduced.basis),
            factors=matmul(reduced.factors, turn),
            strongest=float(strength[-1]),
            shared=shared,
            standard=standard,
            conductance=conductance,
            reading_noise=jnp.asarray(nominal_noise(sensor), pixels.cell.dtype),
            drive=jnp.asarray(sensor.drive_voltage, pixels.cell.dtype),
            grounded=grounded,
            inside=pixels.inside,
        )

    def all_factors(self) -> Float[Array, "L M r"]:
        """Returns J^lBᵀ of all slots."""
        return self.factors

    def calibrated(self, calibration: Calibration) -> "Linear":
        return replace(self, reading_noise=noise_as(calibration, self.noise))

    @property
    def drive_sign(self) -> Float[Array, ""]:
        return jnp.sign(self.drive)

    @property
    def highest(self) -> Float[Array | np.ndarray, ""]:
        return highest_of(self.drive)

    @property
    def noise(self) -> Float[Array, ""]:
        return self.reading_noise

    def scale(self) -> float:
        return self.strongest

    def choose_lambda(self, frames: list[Frame]) -> float:
        """Returns one λ for any frames.

        `tomojax.reconstruct`'s own rule goes decades lower, for the least error of the
        image. Such an image has a peak at every electrode: contacts cannot be read off the
        image.
        """
        return _RELATIVE * self.scale()

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedLinear:
        dtype = self.cell.dtype
        relative = lam / self.scale()
        rank = self.electrode_count * (_FEWER if relative >= _FROM else _RANK)
        basis, factors = (np.asarray(a, float) for a in (self.basis, self.factors))
        basis, factors = basis[:rank], factors[grounds, :, :rank]
        (slots, m), (rank, count) = good.shape, basis.shape
        rows, operators = np.zeros((2, slots, m, rank))
        misfits, placing = np.zeros((slots, m, m)), np.zeros((slots, m, count))
        seen, there = np.zeros(count), np.flatnonzero(good.any(1))
        for k in there:
            own = self.grounded[grounds[k]]
            centre = centring(good[k], own)
            rows[k] = centre @ factors[k]
            # λ is relative to each slot's own σ₁².
            strongest = float(np.linalg.norm(rows[k], 2)) ** 2
            operator = tikhonov_operator(rows[k], relative * strongest)
            operators[k] = operator.T / len(there)
            misfits[k] = rows[k] @ operator - centre
            seen += ((operator.T @ basis) * (rows[k] @ basis)).sum(0)
            placing[k] = _standardized(self.shared, grounds[k], good[k], own)
        step = max(1, slots // _SOME)
        current = np.asarray(self.conductance, float)[grounds[there]].mean(0)
        on_sheet = True if self.inside is None else np.asarray(self.inside).ravel()
        sharp = np.where((seen > 0) & on_sheet, 1 / np.sqrt(np.maximum(seen, 1e-30)), 0)
        return PreparedLinear(
            image=_in_turn(operators.reshape(-1, rank), basis, dtype),
            placing=_short(placing.reshape(-1, count), self.standard, dtype),
            sharp=jnp.asarray(sharp, dtype),
            rows=jnp.asarray(rows[::step], dtype),
            looked=jnp.asarray((good & ~self.grounded[grounds])[::step]),
            misfits=jnp.asarray(misfits, dtype),
            current=jnp.asarray(current[None], dtype),
            used=jnp.asarray(good),
            small=jnp.asarray(relative < _SMALLEST),
        )

    def image(
        self, prepared: PreparedLinear, voltages: Float[Array, "S M"]
    ) -> Float[Array, " pixels"]:
        """Computes φ per pixel, V."""
        return _applied(prepared.image, voltages)

    def estimate(
        self, prepared: PreparedLinear, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        voltages = _more_than_level(voltages, prepared.used)
        phi = self.image(prepared, voltages)
        sharp, placing = (
            self.drive_sign * image.reshape(self.shape)
            for image in (phi * prepared.sharp, _applied(prepared.placing, voltages))
        )
        found = read_contacts(sharp, None, self.cell, count, reach=self.reach)
        lone = (found.count == 1) & (jnp.arange(count) == 0)
        place = self.cell * (highest_place(placing, self.reach) + 0.5)
        found = found._replace(xy=jnp.where(lone[:, None], place, found.xy))
        carried, left = self._explained(prepared, voltages, found)
        there = jnp.arange(count) < found.count.astype(int)
        residual, by_electrode = slots_left(prepared.misfits, voltages, prepared.used)
        flags = bits_of(
            ((left > _UNEXPLAINED) & there[0], Flag.CONTACTS_UNEXPLAINED),
            (prepared.small, Flag.BAD_LAMBDA),
        )
        return Estimate(
            strongest_first(found._replace(current=carried), there),
            phi.reshape(self.shape),
            residual,
            flags=flags,
            by_electrode=by_electrode,
        )

    def _explained(
        self, prepared: PreparedLinear, voltages: Float[Array, "S M"], found: Contacts
    ) -> tuple[Float[Array, " C"], Float[Array, ""]]:
        """Computes the currents of contacts as points, A, and the part that they leave."""
        rows, rank = prepared.rows, prepared.rows.shape[-1]
        step = max(1, len(voltages) // _SOME)
        maps = jnp.concatenate([self.basis[:rank], prepared.current])
        points = point_sources(maps, found, self.shape, self.cell)
        columns = jnp.einsum("smr,cr->scm", rows, points[:, :-1], precision="highest")
        seen = centred(voltages[::step], prepared.looked)
        carried, left = explained(columns, seen)
        return carried.mean(0) * points[:, -1], left


def _more_than_level(
    voltages: Float[Array, "S M"], used: Bool[Array, "S M"]
) -> Float[Array, "S M"]:
    """Takes a slot's level out; what rounding leaves of voltages all alike becomes 0."""
    highest = jnp.abs(jnp.where(used, voltages, 0)).max(1, keepdims=True)
    left = centred(voltages, used)
    rounding = 4 * jnp.finfo(voltages.dtype).eps * highest
    return jnp.where(jnp.abs(left).max(1, keepdims=True) > rounding, left, 0)


def _standardized(
    shared: Shared,
    ground: int,
    good: Bool[np.ndarray, " M"],
    grounded: Bool[np.ndarray, " M"],
) -> Float[np.ndarray, "M pixels"]:
    """Computes (TTᵀ + λI)⁻¹T of a slot, each pixel divided by the root of its resolution.

    T^l's columns less their mean are J's but for their lengths, which do not count.
    """
    maps = factors_of(shared.slots, shared.rows, np.array([ground]))[0]
    maps = centring(good, grounded) @ maps
    square = maps @ maps.T
    more = _PLACING * np.linalg.norm(square, 2) * np.eye(len(maps))
    made = np.linalg.solve(square + more + 1e-30 * np.eye(len(maps)), maps)
    seen = (made * maps).sum(0)
    return made / np.sqrt(seen + _LOW * seen.max() + 1e-30)


def _rows_of(
    matrix: Float[np.ndarray, "n pixels"], most: int
) -> Float[np.ndarray, "q pixels"]:
    """Finds orthonormal rows that hold the `most` strongest of a matrix, in float32."""
    rows = matrix.astype(np.float32)
    count = rows.shape[1]
    basis = np.random.default_rng(0).normal(size=(count, min(most, count)))
    for _ in range(3):
        image = rows.T @ (rows @ basis.astype(np.float32))
        basis = np.linalg.qr(image.astype(float))[0]
    return basis.T.astype(np.float32)


def _short(
    operator: Float[np.ndarray, "SM pixels"],
    basis: Float[np.ndarray, "q pixels"],
    dtype: Any,
) -> tuple[Array, ...]:
    """Makes two matrices of an operator that has more rows than the basis."""
    if len(operator) > len(basis):
        return _in_turn(operator @ basis.T.astype(float), basis, dtype)
    return (jnp.asarray(operator, dtype),)


def _in_turn(
    operator: Float[np.ndarray, "SM r"], basis: Float[np.ndarray, "r pixels"], dtype: Any
) -> tuple[Array, ...]:
    """Makes matrices whose product is operator times basis; one if that is less."""
    whole = len(operator) <= len(basis)
    parts = (operator @ basis,) if whole else (operator, basis)
    return tuple(jnp.asarray(part, dtype) for part in parts)


def _applied(
    matrices: tuple[Array, ...], voltages: Float[Array, "S M"]
) -> Float[Array, " pixels"]:
    values = voltages.ravel()
    for matrix in matrices:
        values = matmul(values, matrix)
    return values


@eqx.filter_jit
def _pixel_jacobian(
    pixels: Pixels, table: Resistances, slots: Slots, grounds: Array
) -> tuple[Float[Array, "L M pixels"], Float[Array, "L pixels"]]:
    """Computes J(0) and 1/loop (S), means over a pixel's elements; ground by ground."""
    rho = jnp.zeros((), pixels.sensor.dtype)

    def one(ground: Array) -> tuple[Array, Array]:
        maps = slots.maps(table.elements, ground[None])
        loop = slots.loops(table, ground[None], maps)
        jacobian = contact_jacobian(maps, loop, rho)
        return pixels.mean(jacobian[0]), pixels.mean(1 / loop[0])

    return jax.lax.map(one, grounds)
