"""`points`: fits a few compact contacts, as many as the voltages ask for."""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer

from tomojax._programs import kept
from tomojax.kernels.contacts import Field, field_at, NARROW, Sheet, thin_of
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import largest_variance, points_as_contacts, points_image, Spots
from tomojax.kernels.sheet import cell_centres, lengthened
from tomojax.methods._contract import (
    AbstractMethod,
    bits_of,
    Estimate,
    highest_of,
    judged,
    Part,
    sign_of,
)
from tomojax.methods._errors import Errors, PreparedErrors
from tomojax.methods._maps import pixels_of
from tomojax.methods._rows import Rows
from tomojax.methods.points._blocks import called, Frames
from tomojax.methods.points._faults import searched
from tomojax.methods.points._films import filmed
from tomojax.methods.points._found import fitting_of, Found
from tomojax.methods.points._ladder import first, steps
from tomojax.sensor import Calibration, make_fields, Sensor

# Usual radius of a contact and unit of the fit's lengths, of the electrodes' pitch: what
# can be told of a contact grows with the pitch, whatever the electrodes' size.
USUAL, UNIT = 0.3, 0.05

# Electrodes nearer than so many pitches are neighbours.
_BESIDE = 1.6


def sheet_of(sensor: Sensor) -> Sheet:
    """Computes the electrodes' potentials, and lengths that suit the sensor."""
    pitch, (field, near) = sensor.mean_pitch, make_fields(sensor)
    usual = jnp.asarray(USUAL * pitch, sensor.dtype)
    narrow = jnp.asarray(NARROW * USUAL * pitch, sensor.dtype)
    thin, resistance = _beside(field, narrow, sensor.sheet_resistance)
    return Sheet(
        field=field,
        thin=thin,
        sheet_resistance=resistance,
        slots=sensor.slots(field.electrodes),
        drive_voltage=sensor.drive_voltage,
        unit=jnp.asarray(UNIT * pitch, sensor.dtype),
        size=usual,
        near=near,
    )


def neighbours_of(sensor: Sensor) -> Integer[np.ndarray, "n 2"]:
    """Lists pairs of electrodes that lie beside each other, or across from a corner."""
    xy = np.asarray(sensor.electrode_xy, float)
    apart = np.sqrt(((xy[:, None] - xy) ** 2).sum(-1))
    near = np.argwhere(np.triu(apart < _BESIDE * sensor.mean_pitch, 1))
    return near if len(near) else np.zeros((1, 2), int)


@jax.jit  # as one program to compile
def _beside(field: Field, narrow: Array, resistance: Array) -> tuple[Array, Array]:
    """Computes the table for narrow contacts, and the sheet's mean resistance."""
    return thin_of(field, narrow), jnp.exp(jnp.mean(jnp.log(resistance)))


# Candidates for each pitch.
_CANDIDATES = 2.5


class Points(AbstractMethod):
    """Contacts as discs, or one bar or ring, each with its own current in each slot.

    The model grows while the fit gains: one disc; two discs, a bar or a ring; three discs.
    Slots share places and sizes, not currents. λ multiplies the variance of the model's
    error: 1 for nominal values. A batch also tries faults of the rig where one disc does
    not do: a short, a leak, a film, crosstalk, wrong channels. `estimate` does not.
    On a calibrated rig discs end as patches, whose currents the sheet decides.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "points", grid=16)
    >>> isinstance(method, tx.methods.Points), method.image_unit
    (True, 'A/m^2')
    """

    image_unit: ClassVar[str] = "A/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore
    tells_covariance: ClassVar[bool] = True
    any_grounds: ClassVar[bool] = True
    films: ClassVar[bool] = True
    stands_out: ClassVar[float] = 3.3
    padded: ClassVar[bool] = False
    seconds_per_slot: ClassVar[float] = 3e-4  # of one or two contacts
    blocks: ClassVar[tuple[int, ...]] = (2048,)

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    sheet: Sheet
    candidates: Float[Array, "K 2"]
    potentials: Float[Array, "K M"]  # of a usual contact at each
    errors: Errors
    spacing: Float[Array, ""]  # of the candidates along y, m
    neighbours: Int[Array, "n 2"]  # electrodes that a wire may join
    inside: Bool[Array, "nx ny"] | None
    grounded: Bool[np.ndarray, "L M"]
    # Whether discs end as patches: where the rig's own errors are known.
    patches: bool = eqx.field(static=True, default=False)
    # Whether a fit goes on to the lowest cost itself: for differences beside slopes.
    exact: bool = eqx.field(static=True, default=False)

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Points":
        """Makes the method for an image of `shape` pixels."""
        sheet = sheet_of(sensor)
        size = np.asarray(sensor.size)
        across = np.ceil(_CANDIDATES * size / sensor.mean_pitch * (1 - 1e-5)).astype(int)
        grid = cell_centres((int(across[0]), int(across[1])))
        candidates = jnp.asarray(grid * size, sensor.dtype)
        if sensor.outline is not None:
            candidates = candidates[np.asarray(sensor.on_sheet(candidates))]
        each = jax.vmap(field_at, (None, 0, None))
        potentials = jax.jit(each)(sheet.field, candidates, sheet.size)
        cell = sensor.size / jnp.asarray(shape, sensor.dtype)
        errors = Errors.of(sensor, sheet.slots)
        return cls(
            shape=shape,
            cell=cell,
            sheet=sheet,
            candidates=candidates,
            potentials=potentials,
            errors=errors,
            spacing=jnp.asarray(size[1] / across[1], sensor.dtype),
            neighbours=jnp.asarray(neighbours_of(sensor), jnp.int32),
            inside=None if sensor.outline is None else pixels_of(sensor, shape).inside,
            grounded=np.asarray(errors.grounded),
        )

    def calibrated(self, calibration: Calibration) -> "Points":
        ground = jnp.asarray(calibration.ground, self.cell.dtype)
        slots = lengthened(self.sheet.slots, self.sheet.field.electrodes, ground)
        sheet = self.sheet._replace(slots=slots)
        errors, known = self.errors.calibrated(calibration), bool(calibration.own < 1)
        return replace(self, sheet=sheet, errors=errors, patches=known)

    @property
    def drive_sign(self) -> Float[Array | np.ndarray, ""]:
        return sign_of(self.sheet.drive_voltage)

    @property
    def highest(self) -> Float[Array | np.ndarray, ""]:
        return highest_of(self.sheet.drive_voltage)

    @property
    def noise(self) -> Float[Array, ""]:
        return self.errors.noise

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedErrors:
        return self.errors.prepare(grounds, good, lam)

    def estimate(
        self, prepared: PreparedErrors, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        scene = fitting_of(self, prepared, voltages, count)
        ladder = first(scene)
        for due, step in steps(count):
            ladder = jax.lax.cond(
                due(ladder), partial(step, scene), lambda found: found, ladder
            )
        return self._described(ladder.best)

    def block(self, prepared: PreparedErrors, part: Part, count: int, images: bool) -> Rows:
        """Estimates n frames; fits a larger model only to the frames that ask for one."""
        volts, grounds = np.asarray(part.voltages), np.asarray(part.grounds)
        frames, every = Frames(self, prepared, volts, grounds, count), np.arange(len(volts))
        if part.films is None:
            found = searched(frames, every)
        else:
            found = filmed(frames, part.films)
        return called(frames, every, _described_all, found, images)

    def _described(self, found: Found) -> Estimate:
        spots = Spots(*(getattr(found, name) for name in Spots._fields))
        told = found.conductance, found.covariance
        contacts = points_as_contacts(found.count, spots, *told)
        image = points_image(spots, self.cell, self.shape)
        # Half of a pitch.
        limit = 0.5 / UNIT * self.sheet.unit
        apart = largest_variance(found.covariance) > limit**2
        flags = bits_of(
            (found.limited, Flag.MODEL_LIMITED),
            (found.faults > 0, Flag.RIG_FAULT),
            # Of all channels together: what is left of a part is little of the whole.
            (found.high, Flag.HIGH_RESIDUAL),
            (apart.any() | found.unsure, Flag.PLACE_UNCERTAIN),
            (found.doubtful, Flag.COUNT_UNCERTAIN),
            (found.vague.any(), Flag.CONDUCTANCE_UNCERTAIN),
        )
        each = found.by_electrode
        return Estimate(contacts, image, found.residual, flags, by_electrode=each)


@kept
def _described_all(
    method, prepared, voltages, grounds, found: Found, most: int, images: bool
) -> Rows:
    def one(found: Found, v: Array) -> Rows:
        return judged(method, method._described(found), v, images)

    return jax.vmap(one)(found, voltages)
