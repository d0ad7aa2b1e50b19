"""`linear`: the paper's Eq. 3 with J(0), prepared once for a ground set."""

from dataclasses import replace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax.kernels.algebra import matmul
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import Contacts, point_sources, read_contacts, unexplained
from tomojax.kernels.sheet import (
    contact_jacobian,
    Resistances,
    Slots,
)
from tomojax.methods._contract import (
    AbstractMethod,
    bits_of,
    centred,
    Estimate,
    Frame,
    rms_by_electrode,
)
from tomojax.methods._errors import noise_as
from tomojax.methods._maps import tikhonov_operator
from tomojax.methods._pixels import Pixels, pixels_of
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

# What the contacts leave of the slots' voltages, each slot with currents of its own and
# without its mean. J(0) places even lone contacts only so well: half of them leave more.
_UNEXPLAINED = 0.09

# Slots that are looked at for that.
_SOME = 8

# λ/σ₁² below which an image in float32 is another than in float64, by 20 mm in one of ten.
_SMALLEST = 1e-6

# λ/σ₁² of `tomojax table1`.
_RELATIVE = 1.8e-3


class PreparedLinear(NamedTuple):
    """Arrays for one ground set with its good channels."""

    operator: Float[Array, "SM r"]  # coefficients of φ from the voltages
    rows: Float[Array, "SM r"]  # and back
    current: Float[Array, " pixels"]  # A per volt of φ, the mean over the slots
    used: Bool[Array, "S M"]
    small: Bool[Array, ""]  # whether λ is less than numbers and basis hold


class Linear(AbstractMethod):
    """φ = (J_sᵀJ_s + λI)⁻¹J_sᵀV_s with J(0) in a basis of its strongest rows.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "linear", grid=16)
    >>> isinstance(method, tx.methods.Linear), method.image_unit
    (True, 'V')
    """

    image_unit: ClassVar[str] = "V"  # pyright: ignore
    # Strong contacts draw another current in every slot; J(0) has one for all.
    residual_limit: ClassVar[float] = 0.5  # pyright: ignore

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    basis: Float[Array, "r pixels"]
    factors: Float[Array, "L M r"]  # J^l Bᵀ
    conductance: Float[Array, "L pixels"]  # of the loop from a pixel to each ground, S
    reading_noise: Float[Array, ""]
    polarity: Float[Array, ""]  # of the drive: 1 or −1
    grounded: Bool[np.ndarray, "L M"]
    inside: Bool[Array, "nx ny"] | None = None

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Linear":
        """Makes the method for an image of `shape` pixels."""
        # An even rectangle has no mesh error. On one cell an electrode J is highest at the
        # rim, and so are images, wherever the contact is.
        pixels = pixels_of(sensor, shape, 1 if sensor.flat else _CELLS)
        sensor = pixels.sensor
        table = resistances(sensor, "series" if sensor.even else "fem")
        grounds = jnp.asarray(sensor.all_grounds())
        slots = sensor.slots(table.electrodes)
        maps, conductance = _pixel_jacobian(pixels, table, slots, grounds)
        noise, sign = nominal_noise(sensor), float(np.sign(sensor.drive_voltage))
        made = cls.from_maps(maps, conductance, shape, pixels.cell, noise, sign)
        grounded = np.asarray(slots.grounded(grounds))
        return replace(made, inside=pixels.inside, grounded=grounded)

    def all_factors(self) -> Float[Array, "L M r"]:
        """Returns J^lBᵀ of all slots."""
        return self.factors

    @classmethod
    def from_maps(
        cls,
        maps: Array,
        conductance: Array,
        shape: tuple[int, int],
        cell: Array,
        noise: float = 0.0,
        polarity: float = 1.0,
    ) -> "Linear":
        """Makes the method of any J (L, M, pixels); `noise` V; `polarity` of the drive."""
        rank = min(_RANK * maps.shape[1], maps.shape[0] * maps.shape[1], maps.shape[2])
        reduced = reduce_jacobian(maps, rank)
        # The strongest directions first, so that any number of them is the best choice.
        turn = np.linalg.eigh(np.asarray(reduced.grams, float).sum(0))[1][:, ::-1]
        turn = jnp.asarray(turn.copy(), maps.dtype)
        return cls(
            shape=shape,
            cell=cell,
            basis=matmul(turn.T, reduced.basis),
            factors=matmul(reduced.factors, turn),
            conductance=conductance,
            reading_noise=jnp.asarray(noise, cell.dtype),
            polarity=jnp.asarray(polarity, cell.dtype),
            grounded=np.eye(*maps.shape[:2], dtype=bool),
        )

    def calibrated(self, calibration: Calibration) -> "Linear":
        return replace(self, reading_noise=noise_as(calibration, self.noise))

    @property
    def drive_sign(self) -> Float[Array, ""]:
        return self.polarity

    @property
    def noise(self) -> Float[Array, ""]:
        return self.reading_noise

    def scale(self) -> float:
        rows = np.asarray(self.factors, float).reshape(-1, self.factors.shape[-1])
        return float(np.linalg.eigvalsh(rows.T @ rows)[-1])

    def choose_lambda(self, frames: list[Frame]) -> float:
        """Returns Table I's λ for any frames: this λ makes *All* as wide as the paper's.

        `tomojax.reconstruct`'s own rule goes decades lower, for the least error of the
        image. Such an image has a peak at every electrode: contacts cannot be read off the
        image.
        """
        return _RELATIVE * self.scale()

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedLinear:
        dtype = self.cell.dtype
        scale = self.scale()
        fewer = self.electrode_count * (_FEWER if lam >= _FROM * scale else _RANK)
        rows = np.asarray(self.factors[..., :fewer], float)[grounds] * good[:, :, None]
        rows = rows.reshape(-1, rows.shape[-1])
        current = np.asarray(self.conductance, float)[grounds[good.any(1)]].mean(0)
        return PreparedLinear(
            operator=jnp.asarray(tikhonov_operator(rows, lam).T, dtype),
            rows=jnp.asarray(rows, dtype),
            current=jnp.asarray(current, dtype),
            used=jnp.asarray(good),
            small=jnp.asarray(lam < _SMALLEST * scale),
        )

    def image(
        self, prepared: PreparedLinear, voltages: Float[Array, "S M"]
    ) -> tuple[Array, Array]:
        """Returns φ per pixel (or element, for a J of elements) and its coefficients."""
        coefficients = matmul(voltages.ravel(), prepared.operator)
        return matmul(coefficients, self.basis[: len(coefficients)]), coefficients

    def estimate(
        self, prepared: PreparedLinear, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        phi, coefficients = self.image(prepared, voltages)
        forward = self.drive_sign * phi
        current = (forward * prepared.current).reshape(self.shape)
        # As the paper reads its images: above half the maximum.
        heights = forward.reshape(self.shape)
        contacts = read_contacts(heights, current, self.cell, count, 0.5, False)
        misfit = matmul(prepared.rows, coefficients) - voltages.ravel()
        misfit = misfit.reshape(voltages.shape)
        flags = bits_of(
            (self._unexplained(prepared, voltages, contacts), Flag.CONTACTS_UNEXPLAINED),
            (prepared.small, Flag.BAD_LAMBDA),
        )
        return Estimate(
            contacts._replace(current=self.drive_sign * contacts.current),
            phi.reshape(self.shape),
            residual=jnp.sqrt(jnp.mean(misfit**2, where=prepared.used)),
            flags=flags,
            by_electrode=rms_by_electrode(misfit, prepared.used),
        )

    def _unexplained(
        self, prepared: PreparedLinear, voltages: Float[Array, "S M"], contacts: Contacts
    ) -> Bool[Array, ""]:
        """Tells whether contacts leave too much; J(0)'s columns have T's shape."""
        step = max(1, len(voltages) // _SOME)
        rows = prepared.rows.reshape(*voltages.shape, -1)[::step]
        used = prepared.used[::step]
        basis = self.basis[: rows.shape[-1]]
        points = point_sources(basis, contacts, self.shape, self.cell)
        columns = jnp.einsum("smr,cr->scm", rows, points, precision="highest")
        left = unexplained(centred(columns, used[:, None]), centred(voltages[::step], used))
        return (left > _UNEXPLAINED) & (contacts.count > 0)


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
