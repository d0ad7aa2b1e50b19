"""Fits the model of `shape`: a field of two levels on the image's pixels."""

from dataclasses import replace
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels import shapes
from tomojax.kernels.contacts import whitened_columns
from tomojax.kernels.sheet import (
    ground_voltages,
    lengthened,
    reduce_sites,
    Slots,
    voltage_drop,
)
from tomojax.methods._contract import (
    AbstractMethod,
    highest_of,
    rms,
    rms_by_electrode,
    sign_of,
)
from tomojax.methods._errors import (
    Errors,
    misfit_cost,
    PreparedErrors,
    seen,
    whitened,
    without_offset,
)
from tomojax.methods._maps import pixel_sites, pixels_of
from tomojax.methods._source import PreparedSource, Source
from tomojax.sensor import Calibration, Sensor

# Cells of the mesh that are no wider than an electrode.
CELLS = 2

# Slots that a shape is fitted to, at most, the grounds as far apart as can be. On simulated
# letters, rings and hands 64 slots overlapped no better than 16 of them, on rigs without
# errors neither, and took three times as long.
_SLOTS = 16

# How many slots errors of the model leave independent: the same sheet, electrodes and gains
# are behind all.
_INDEPENDENT = 12.0

# The coarse fit's pixels, of the image's along each side, and its waves, of the image's.
_COARSER = 2
_WAVES = 2

# Evaluations of the coarse fit, and the gain, as a part of the cost, at which it ends.
_FIRST = 16
_ENOUGH = 5e-3

# The same of the fine fit.
_THEN = 8
_ENOUGH_THEN = 3e-3

# The level of a film's next frame, of what came out of the one before (of which a fit makes
# less, so that both settle).
_NEXT = 1.28

# A film's frame starts anew where the cost is so many times as high, or what came out is
# less than this part of the level: the object presses less, or is gone.
_MORE = 2.0
_UNDER = 0.55

# The coarse fit's level, of that of `source`'s blurred image: far above what is there, so
# that the field is in proportion to what the data ask for.
_HIGH = 40.0

# The fine fit's level, of what came out.
_LEVEL = 0.85

# V0 − u at a contact is no less than this part of V0, for a start.
_DROP = 0.1

# The start's λ, of σ₁².
_START = 1e-4


class PreparedShape(NamedTuple):
    """Arrays for S slots with their good channels."""

    source: PreparedSource  # for the start
    errors: PreparedErrors
    fitted: Int[Array, " s"]  # the slots that the shape is fitted to
    some: PreparedErrors  # theirs


class Before(NamedTuple):
    """A start for a film's next frame."""

    w: Float[Array, " K"]
    level: Float[Array, "nx ny"]  # S/m²
    cost: Float[Array, ""]  # inf: nothing is known


class Turn(NamedTuple):
    """A fit, and how to go on."""

    fit: shapes.ShapeFit
    level: Float[Array, "nx ny"]  # S/m²
    anew: Bool[Array, ""]  # whether the next fit begins with a coarse one
    ended: Bool[Array, ""]


class FittedShape(NamedTuple):
    """A shape fitted to one frame."""

    fit: shapes.ShapeFit
    level: Float[Array, "nx ny"]  # S/m² of what touches
    conductance: Float[Array, "nx ny"]  # S/m²
    current: Float[Array, "nx ny"]  # A per pixel, the mean over the slots
    touch: Float[Array, "nx ny"]  # the probability
    deviation: Float[Array, "nx ny"]  # of the conductance, S/m²
    cost: Float[Array, ""]  # per slot, of the whitened misfit, of the tolerance
    seen: Bool[Array, ""]
    residual: Float[Array, ""]  # V rms
    by_electrode: Float[Array, " M"]
    highest: Float[Array, ""]  # |V|
    next: Before


_S = TypeVar("_S", bound="AbstractShape")  # typing.Self, which beartype cannot check here


class AbstractShape(AbstractMethod):
    """The fit of a shape to a frame.

    A coarse fit, whose level is far above the object's, starts from nothing. Each place's
    level is then read off the coarse fit. A fine fit follows.
    """

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    source: Source
    fine: shapes.PixelSites
    field: shapes.TwoLevels
    coarse: shapes.PixelSites
    coarse_field: shapes.TwoLevels
    errors: Errors
    sheet_resistance: Float[Array, ""]
    slots: Slots
    ground_xy: Float[Array, "L 2"]  # where the current of each ground leaves, m
    inside: Bool[Array, "nx ny"] | None
    grounded: Bool[np.ndarray, "L M"]
    drive_voltage: Float[Array, ""]
    pitch: Float[Array, ""]

    @property
    def drive_sign(self) -> Float[Array | np.ndarray, ""]:
        return sign_of(self.drive_voltage)

    @property
    def highest(self) -> Float[Array | np.ndarray, ""]:
        return highest_of(self.drive_voltage)

    @property
    def noise(self) -> Float[Array, ""]:
        return self.errors.noise

    @classmethod
    def of(cls: type[_S], sensor: Sensor, shape: tuple[int, int]) -> _S:
        """Makes the method for an image of `shape` pixels."""
        # Metal discs where the sensor leaves it open, as for `points`.
        if sensor.electrode_shunt is None:
            sensor = replace(sensor, electrode_shunt=1.0)
        less = (max(1, shape[0] // _COARSER), max(1, shape[1] // _COARSER))
        fine, coarse = (pixels_of(sensor, s, CELLS) for s in (shape, less))
        size, pitch = np.asarray(sensor.size, float), sensor.mean_pitch
        field = shapes.modes_of(shape, size, pitch, sensor.dtype)
        few = shapes.modes_of(less, size, pitch, sensor.dtype)
        sites = pixel_sites(fine.sensor, shape)
        count = sensor.electrode_count
        slots = sensor.slots(sites.table[-count:, -count:])
        few = few._replace(waves=few.waves[:, :, : -(-few.waves.shape[2] // _WAVES)])
        source = Source.of(sensor, shape)
        # pyright takes what is a ClassVar by its meaning for a field.
        return cls(  # pyright: ignore
            shape=shape,
            cell=fine.cell,
            source=source,
            fine=sites,
            field=field,
            coarse=pixel_sites(coarse.sensor, less),
            coarse_field=few,
            errors=Errors.of(sensor, slots),
            sheet_resistance=jnp.exp(jnp.mean(jnp.log(fine.sensor.sheet_resistance))),
            slots=slots,
            ground_xy=sensor.ground_xy(),
            inside=source.inside,
            grounded=source.grounded,
            drive_voltage=fine.sensor.drive_voltage,
            pitch=jnp.asarray(pitch, sensor.dtype),
        )

    def calibrated(self: _S, calibration: Calibration) -> _S:
        """Returns the method with the calibration's errors and ground path."""
        ground = jnp.asarray(calibration.ground, self.cell.dtype)
        errors, source = (a.calibrated(calibration) for a in (self.errors, self.source))
        count = self.electrode_count
        slots = lengthened(self.slots, self.fine.table[-count:, -count:], ground)
        return replace(self, errors=errors, source=source, slots=slots)

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedShape:
        start = self.source.prepare(grounds, good, _START * self.source.scale())
        errors = self.errors.prepare(grounds, good, lam)
        xy = np.asarray(self.ground_xy, float)[grounds]
        used = np.asarray(np.asarray(errors.used).any(1))
        some = _far_apart(xy, used, _SLOTS)
        ready = self.errors.prepare(grounds[some], good[some], lam)
        return PreparedShape(start, errors, jnp.asarray(some), ready)

    def nothing_before(self) -> Before:
        """Returns the start of a frame that no frame came before."""
        dtype = self.cell.dtype
        w = jnp.zeros(self.field.waves.shape[2], dtype)
        return Before(w, jnp.zeros(self.shape, dtype), jnp.asarray(jnp.inf, dtype))

    def fitted(
        self,
        prepared: PreparedShape,
        voltages: Float[Array, "S M"],
        before: Before,
        follow: bool = False,
    ) -> FittedShape:
        """Fits the image and tells its misfit; `follow` adds the image's derivative."""
        given = self._told(prepared.some, voltages[prepared.fitted])
        told: shapes.Told = jax.lax.stop_gradient(given)
        still = jax.lax.stop_gradient(voltages)
        fit, level = self._from(told, before, self._level(prepared.source, still))
        each = (level * jnp.prod(self.cell)).ravel()
        scene = shapes.Scene(self.field, self.fine, told, each)
        curvature = shapes.shape_curvature(scene, fit)
        sure = shapes.spread(self.field, curvature, fit.w)
        if follow:
            fit = shapes.followed(scene._replace(told=given), fit)
        conductance = level * self.touched(fit)
        near = _NEXT * shapes.levels(conductance, self.cell, self.pitch)
        images = {
            "level": level,
            "conductance": conductance,
            "touch": self.on_sheet(sure.touch),
            "deviation": level * sure.deviation.reshape(self.shape),
        }
        ahead = Before(fit.w, near, fit.cost)
        return self._judged(prepared.errors, voltages, fit, images, ahead)

    def on_sheet(self, values: Float[Array, " pixels"]) -> Float[Array, "nx ny"]:
        """Returns an image that is 0 off the sheet, where no voltage tells of the field."""
        image = values.reshape(self.shape)
        return image if self.inside is None else jnp.where(self.inside, image, 0)

    def touched(self, fit: shapes.ShapeFit) -> Float[Array, "nx ny"]:
        """Returns the part of each pixel that touches."""
        return self.on_sheet(fit.touch)

    def _from(
        self, told: shapes.Told, before: Before, blurred: Float[Array, ""]
    ) -> tuple[shapes.ShapeFit, Float[Array, "nx ny"]]:
        """Fits the fine field from the frame before, or from a coarse fit.

        A fit that the frame before began is given up where its end is no good. The loop
        holds each of the two fits once: they are most of what has to be compiled.
        """

        def fine(w: Array, level: Array) -> shapes.ShapeFit:
            each = (level * jnp.prod(self.cell)).ravel()
            scene = shapes.Scene(self.field, self.fine, told, each)
            return shapes.fit_shape(scene, w, _THEN, _ENOUGH_THEN)

        def turn(run: Turn) -> Turn:
            w, level = jax.lax.cond(
                run.anew,
                lambda: self._coarse(told, blurred),
                lambda: (before.w, before.level),
            )
            fit = fine(w, level)
            image = level * self.touched(fit)
            under = (image**2).sum() < _UNDER * (image * level).sum()
            worse = ~(fit.cost <= _MORE * before.cost) | under
            return Turn(fit, level, jnp.array(True), run.anew | ~worse)

        about = jax.eval_shape(fine, before.w, before.level)
        nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), about)
        anew = ~jnp.isfinite(before.cost)
        first = Turn(nothing, before.level, anew, jnp.array(False))
        ended: Turn = jax.lax.while_loop(lambda run: ~run.ended, turn, first)
        return ended.fit, ended.level

    def every_slot(self) -> PreparedErrors:
        """Prepares the errors of all grounds' voltages, every channel good. Host code."""
        grounds, channels = self.errors.grounded.shape
        return self.errors.prepare(
            np.arange(grounds), np.ones((grounds, channels), bool), 1.0
        )

    def slopes_at(
        self, errors: PreparedErrors, w: Float[Array, " K"]
    ) -> Float[Array, "L W K"]:
        """Returns the slopes of each slot's whitened voltages by the field, at `w`.

        The object conducts so well that current enters within a pitch of its rim.
        """
        count = self.electrode_count
        level = jnp.prod(self.cell) / (self.sheet_resistance * self.pitch**2)
        each = jnp.broadcast_to(level, self.fine.on_sheet.shape)
        touch, steep = shapes.touching(self.field.waves, self.field.mean, w)
        contact = reduce_sites(self.fine.table, self.fine.of(each * touch), count)
        law = self.slots, errors.grounds, self.drive_voltage
        told = self._told(errors, ground_voltages(contact, *law))
        at = shapes.Evaluated(0 * told.frame.whitened, contact)
        scene = shapes.Scene(self.field, self.fine, told, each)
        return shapes.shape_slopes(scene, steep, at)

    def _told(self, errors: PreparedErrors, voltages: Float[Array, "S M"]) -> shapes.Told:
        return shapes.Told(
            voltages=voltages,
            frame=whitened(errors, voltages).frame,
            tolerance=errors.tolerance,
            part=jnp.minimum(1, _INDEPENDENT / errors.slot_count),
            slots=self.slots,
            drive_voltage=self.drive_voltage,
        )

    def _judged(
        self,
        errors: PreparedErrors,
        voltages: Float[Array, "S M"],
        fit: shapes.ShapeFit,
        images: dict[str, Array],
        ahead: Before,
    ) -> FittedShape:
        """Compares the fit with the voltages of all slots."""
        law, contact = (self.slots, errors.grounds, self.drive_voltage), fit.at.contact
        drop = errors.mean(voltage_drop(contact, *law))
        flat = images["conductance"].ravel() * jnp.prod(self.cell)
        (at_pixels,) = jax.linear_transpose(self.fine.of, flat)(drop)
        left = ground_voltages(contact, *law) - voltages
        frame = whitened(errors, voltages).frame
        misfits = (whitened_columns(frame, left) ** 2).sum(1)
        costs = misfit_cost(misfits, errors.tolerance)
        misfit, used = without_offset(errors, left)
        return FittedShape(
            fit,
            **images,
            current=(flat * at_pixels).reshape(self.shape),
            cost=costs.sum() / errors.slot_count / errors.tolerance,
            seen=seen(errors, frame, costs),
            residual=rms(misfit, used),
            by_electrode=rms_by_electrode(misfit, used),
            highest=jnp.abs(voltages).max(),
            next=ahead,
        )

    def _level(
        self, prepared: PreparedSource, voltages: Float[Array, "S M"]
    ) -> Float[Array, ""]:
        """Returns the level of `source`'s image, S/m²."""
        current = self.source.image(prepared, voltages)
        v0 = self.drive_voltage
        # What is under a contact is hardly higher than the highest electrode.
        drop = jnp.maximum(jnp.abs(v0) - jnp.abs(voltages).max(), _DROP * jnp.abs(v0))
        guess = jnp.maximum(jnp.sign(v0) * current / drop, 0)
        tiny = jnp.finfo(guess.dtype).tiny
        return ((guess**2).sum() + tiny) / (guess.sum() + tiny) / jnp.prod(self.cell)

    def _coarse(
        self, told: shapes.Told, blurred: Float[Array, ""]
    ) -> tuple[Float[Array, " K"], Float[Array, "nx ny"]]:
        """Returns the fine fit's first field, and the level of the coarse fit, S/m²."""
        field, sites = self.coarse_field, self.coarse
        area = jnp.prod(self.cell) * self.fine.on_sheet.size / sites.on_sheet.size
        level = _HIGH * blurred
        n, _, few = field.waves.shape
        start = jnp.zeros(few, level.dtype)
        each = jnp.broadcast_to(level * area, n)
        scene = shapes.Scene(field, sites, told, each)
        fit = shapes.fit_shape(scene, start, _FIRST, _ENOUGH)
        touch, _ = shapes.touching(self.field.waves[:, :, :few], self.field.mean, fit.w)
        image = level * touch
        near = _LEVEL * shapes.levels(image.reshape(self.shape), self.cell, self.pitch)
        return shapes.near_touching(self.field, image / near.ravel()), near


def _far_apart(
    xy: Float[np.ndarray, "S 2"], used: Bool[np.ndarray, " S"], most: int
) -> Int[np.ndarray, " s"]:
    """Chooses up to `most` used slots, each ground far from the grounds before."""
    slots = np.flatnonzero(used) if used.any() else np.arange(len(used))
    if len(slots) <= most:
        return slots
    away = ((xy[slots] - xy[slots].mean(0)) ** 2).sum(1)
    chosen = [int(away.argmax())]
    nearest = np.full(len(slots), np.inf)
    while len(chosen) < most:
        nearest = np.minimum(nearest, ((xy[slots] - xy[slots[chosen[-1]]]) ** 2).sum(1))
        nearest[chosen] = -1
        chosen.append(int(nearest.argmax()))
    return slots[np.sort(chosen)]
