"""`conductance`: finds g ≥ 0 at every pixel, from the exact contact model and all slots."""

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer

from tomojax._programs import kept
from tomojax.kernels.algebra import (
    gaussian,
    matmul,
    near_positive,
    positive_least_squares,
    PositiveFit,
    smooth_prior,
    SmoothPrior,
)
from tomojax.kernels.contacts import whitened_columns
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import read_regions
from tomojax.kernels.sheet import (
    ContactReduction,
    ground_voltages,
    reduce_sites,
    voltage_change,
    voltage_drop,
)
from tomojax.methods._contract import (
    AbstractMethod,
    Estimate,
    Frame,
    judged,
    rms,
    rms_by_electrode,
)
from tomojax.methods._errors import (
    Errors,
    misfit_cost,
    PreparedErrors,
    seen,
    whitened,
    without_offset,
)
from tomojax.methods._pixels import pixels_of, site_table
from tomojax.methods._rows import Rows
from tomojax.methods._source import PreparedSource, Source
from tomojax.sensor import Calibration, Sensor

# What is known of ln g beforehand: its mean below the start's highest and its standard
# deviation; and the length over which it is alike, of the electrodes' pitch.
_LEVEL, _WIDTH, _LENGTH = -6.0, 2.5, 0.2

# V0 − u at a contact is no less than this part of V0, for a start; evaluations of a fit.
_DROP, _STEPS = 0.1, 25

# A pixel's current saturates with its g by its own resistance, and by what its neighbours
# that carry current as well add to that: so many times as much.
_TOGETHER = 3.0

# Contacts are read off an image blurred by as much, of the electrodes' pitch; from
# this part of their peak on.
_BLUR, _FROM = 0.2, 0.1

# What a further region carries of what the first does, to be one that is not told of.
# Highest voltage, in the converter's noise, that places a contact.
_OTHERS, _FAINT = 0.1, 30.0

# A contact on more than this, of what an electrode has of the sheet, is seen by its rim.
_WIDE = 1.05

# A contact's conductance is told up to that of so many squares of the sheet: beyond, the
# sheet's own resistance below it is the most of what is measured.
_TOLD = 3.0

# The start's λ, of σ₁².
_START = 1e-4


class PreparedConductance(NamedTuple):
    """Arrays for S slots with their good channels."""

    source: PreparedSource  # for the start
    errors: PreparedErrors  # of the voltages


class Fitted(NamedTuple):
    """A fit of one frame."""

    conductance: Float[Array, "nx ny"]  # S per pixel
    current: Float[Array, "nx ny"]  # A per pixel, the mean over the slots
    cost: Float[Array, ""]  # per slot, of the whitened misfit, of the tolerance
    seen: Bool[Array, ""]  # whether no contact would not do
    residual: Float[Array, ""]  # V rms
    by_electrode: Float[Array, " M"]
    highest: Float[Array, ""]  # |V|


class Conductance(AbstractMethod):
    """The likeliest g; beforehand ln g is smooth and spans decades. λ is that of `points`.

    The start is `source`'s image. The sheet is solved once, for the resistances between
    pixels and electrodes, on a mesh that resolves the electrodes. A frame needs factors of
    the pixels in contact alone. An object may conduct much better than the sheet: g is then
    a lower bound.
    """

    image_unit: ClassVar[str] = "S/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore
    stands_out: ClassVar[float] = 3.3
    cells_per_diameter: ClassVar[int] = 2
    padded: ClassVar[bool] = False
    seconds_per_slot: ClassVar[float] = 5e-3  # 7 ms alone, 40 ms for ten

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    source: Source
    table: Float[Array, "sites sites"]  # Ω, between pixels and electrodes, those last
    on_sheet: Float[Array, " pixels"]  # the part of a pixel's contact on no electrode
    metal: Float[Array, "pixels M"]  # and the part on each
    errors: Errors
    sheet_resistance: Float[Array, ""]
    ground_resistance: Float[Array, "..."]
    drive_voltage: Float[Array, ""]
    pitch: Float[Array, ""]

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Conductance":
        """Makes the method for an image of `shape` pixels."""
        # Metal discs where the sensor leaves it open, as for `points`.
        if sensor.electrode_shunt is None:
            sensor = replace(sensor, electrode_shunt=1.0)
        source = Source.of(sensor, shape)
        pixels = pixels_of(sensor, shape, cls.cells_per_diameter)
        fine = pixels.sensor
        table, on_sheet, metal = site_table(fine, shape)
        return cls(
            shape,
            pixels.cell,
            source,
            table,
            on_sheet,
            metal,
            Errors.of(sensor),
            jnp.exp(jnp.mean(jnp.log(fine.sheet_resistance))),
            fine.ground_resistance,
            fine.drive_voltage,
            jnp.asarray(fine.mean_pitch, fine.dtype),
        )

    def calibrated(self, calibration: Calibration) -> "Conductance":
        ground = jnp.asarray(calibration.ground, self.cell.dtype)
        errors, source = (a.calibrated(calibration) for a in (self.errors, self.source))
        resistance = self.ground_resistance + ground
        return replace(self, errors=errors, source=source, ground_resistance=resistance)

    @property
    def drive_sign(self) -> Float[Array, ""]:
        return jnp.sign(self.drive_voltage)

    @property
    def noise(self) -> Float[Array, ""]:
        return self.errors.noise

    @property
    def electrode_count(self) -> int:
        return self.source.electrode_count

    def choose_lambda(self, frames: list[Frame]) -> float:
        """Returns λ = 1: the error of a sheet with nominal values."""
        return 1.0

    def scale(self) -> float:
        return 1.0

    def prepare(
        self, grounds: np.ndarray, good: np.ndarray, lam: float
    ) -> PreparedConductance:
        start = self.source.prepare(grounds, good, _START * self.source.scale())
        return PreparedConductance(start, self.errors.prepare(grounds, good, lam))

    def estimate(
        self, prepared: PreparedConductance, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        fitted = self.fitted(prepared, voltages)
        area = jnp.prod(self.cell)
        return self.described(fitted, fitted.conductance / area, count)

    def block(
        self,
        prepared: PreparedConductance,
        voltages: Float[Array, "n S M"],
        grounds: Integer[np.ndarray, "n S"],
        count: int,
        images: bool,
        films: Int[np.ndarray, " n"] | None = None,
    ) -> Rows:
        """Estimates n frames one by one: each fit ends after steps of its own."""
        rows = [_row(self, prepared, v, count, images) for v in voltages]
        return jax.tree.map(lambda *r: np.stack(r), *rows)

    def fitted(
        self, prepared: PreparedConductance, voltages: Float[Array, "S M"]
    ) -> Fitted:
        """Fits the image to the voltages; returns the image and its misfit."""
        errors, z, v0 = prepared.errors, self.ground_resistance, self.drive_voltage
        frame = whitened(errors, voltages).frame

        def model(values: Array) -> tuple[Array, ContactReduction]:
            sites = self._sites(values)
            contact = reduce_sites(self.table, sites, self.electrode_count)
            volts = ground_voltages(contact, frame.grounds, z, v0)
            return whitened_columns(frame, volts - voltages), contact

        def slopes(contact: ContactReduction) -> Callable[[Array], Array]:
            change = voltage_change(contact, frame.grounds, z, v0)
            return lambda values: whitened_columns(frame, change(self._sites(values)))

        prior, start = self._start(prepared.source, voltages)
        own = _TOGETHER * jnp.diagonal(self.table)[: start.size].reshape(self.shape)
        fit: PositiveFit = positive_least_squares(
            model, slopes, own, prior, start, errors.tolerance, _STEPS
        )
        contact = fit.state
        drop = voltage_drop(contact, frame.grounds, z, v0)
        slots = errors.used.any(1)
        n = jnp.maximum(slots.sum(), 1).astype(drop.dtype)
        mean = jnp.where(slots[:, None], drop, 0).sum(0) / n
        (at_pixels,) = jax.linear_transpose(self._sites, fit.values)(mean)
        volts = ground_voltages(contact, frame.grounds, z, v0)
        misfit, used = without_offset(errors, volts - voltages)
        return Fitted(
            fit.values,
            fit.values * at_pixels,
            fit.cost / n / errors.tolerance,
            seen(errors, frame, misfit_cost(fit.misfits, errors.tolerance)),
            rms(misfit, used),
            rms_by_electrode(misfit, used),
            jnp.abs(voltages).max(),
        )

    def described(
        self, fitted: Fitted, image: Float[Array, "nx ny"], count: int
    ) -> Estimate:
        """Reads contacts off blurred regions that impose their potential on the sheet.

        Each pixel has gρ/(1 + gρ): in proportion to g where g is small, 1 for metal.
        """
        share = fitted.conductance * self.sheet_resistance
        share = share / (1 + share)
        wide = share.mean() > _WIDE / self.electrode_count
        along, across = (
            gaussian(n, length)
            for n, length in zip(self.shape, _BLUR * self.pitch / self.cell)
        )
        share = matmul(matmul(along, share), across.T)
        read = lambda carried: read_regions(  # noqa: E731
            share, carried, self.cell, count + 1, _FROM
        )
        contacts, flow = read(fitted.conductance), read(fitted.current)
        # One more than are asked for says that there are others.
        more = contacts.current[count] > _OTHERS * contacts.current[0]
        contacts = contacts._replace(conductance=contacts.current, current=flow.current)
        some = jnp.minimum(contacts.count, count)
        contacts = jax.tree.map(lambda a: a[:count] if a.ndim else a, contacts)
        contacts = contacts._replace(
            count=jnp.where(fitted.seen, some, 0).astype(jnp.uint8)
        )
        faint = fitted.seen & (fitted.highest < _FAINT * self.noise)
        # As of a disc whose size nothing tells; NaN is no contact.
        gap = jnp.nan_to_num(contacts.conductance) * self.sheet_resistance
        vague = (gap > _TOLD).any() & fitted.seen
        bits = (
            (fitted.cost > 1, Flag.HIGH_RESIDUAL),
            (more, Flag.CONTACTS_UNEXPLAINED),
            (faint | wide, Flag.PLACE_UNCERTAIN),
            (vague, Flag.CONDUCTANCE_UNCERTAIN),
        )
        flags = jnp.stack([jnp.where(on, bit.value, 0) for on, bit in bits]).sum()
        return Estimate(
            contacts, image, fitted.residual, flags, by_electrode=fitted.by_electrode
        )

    def _sites(self, values: Float[Array, "nx ny"]) -> Float[Array, " sites"]:
        """Splits pixels' values among the pixels' own sites and the electrodes' metal."""
        flat = values.ravel()
        return jnp.concatenate([flat * self.on_sheet, matmul(flat, self.metal)])

    def _start(
        self, prepared: PreparedSource, voltages: Float[Array, "S M"]
    ) -> tuple[SmoothPrior, Float[Array, "nx ny"]]:
        current = self.source.image(prepared, voltages).reshape(self.shape)
        v0 = self.drive_voltage
        # What is under a contact is hardly higher than the highest electrode.
        drop = jnp.maximum(jnp.abs(v0) - jnp.abs(voltages).max(), _DROP * jnp.abs(v0))
        tiny = 1e-12 / self.sheet_resistance
        guess = jnp.maximum(jnp.sign(v0) * current / drop, tiny)
        level = jnp.log(guess.max()) + _LEVEL
        length = _LENGTH * self.pitch / self.cell
        prior = smooth_prior(self.shape, length, _WIDTH, level)
        return prior, near_positive(prior, guess)


@kept
def _row(
    method: Conductance,
    prepared: PreparedConductance,
    voltages: Float[Array, "S M"],
    count: int,
    images: bool,
) -> Rows:
    return judged(method, method.estimate(prepared, voltages, count), voltages, images)
