"""`points`: a few compact contacts, fitted; as many as the voltages ask for."""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer

from tomojax import kernels
from tomojax._calibration import Calibration, NOISE
from tomojax._field import make_field
from tomojax._method import AbstractMethod, Estimate, Frame, judged
from tomojax._points_fit import Found, Prepared, scene_of, TOLERANCE
from tomojax._points_ladder import first, Ladder, steps
from tomojax._sensor import Sensor
from tomojax.kernels import _points as model
from tomojax.kernels._whiten import smooth_modes

# What nominal values leave of measured voltages, as parts of them: each electrode's own
# error (place, gain, detail of the sheet), of which this part of how its voltage differs
# from its neighbours'; what they have in common, the longest waves over the sheet; and a
# slot's mean. From a resistor network that varies by 1.5 to 3 %, electrodes 0.15 mm off.
_OWN, _BEND, _SMOOTH, _OFFSET = 0.0015, 0.04, 0.003, 0.02

# Usual radius of a contact and unit of the fit's lengths, of the electrodes' diameter.
_USUAL, _UNIT = 1.2, 0.2

# Candidates along a side, and the slots that they are compared in.
_CANDIDATES, _SLOTS = 20, 4

# Frames of a compiled call.
_BLOCK = 32


class Points(AbstractMethod):
    """Contacts as discs, or one bar or ring, with a current of their own in each slot.

    The model grows while it gains: one disc, two discs or a bar or a ring, three discs, …
    Slots share places and sizes, not currents. λ multiplies the variance of the model's
    error: 1 for nominal values.
    """

    image_unit: ClassVar[str] = "A/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore
    tells_covariance: ClassVar[bool] = True
    any_grounds: ClassVar[bool] = True
    threshold: ClassVar[float] = 0.0015
    blocks: ClassVar[tuple[int, ...]] = tuple(range(_BLOCK, 33 * _BLOCK, _BLOCK))

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    sheet: model.Sheet
    candidates: Float[Array, "K 2"]
    potentials: Float[Array, "K M"]  # of a usual contact at each
    electrode_xy: Float[Array, "M 2"]
    noise: Float[Array, ""]  # of the converter, V
    error: Float[Array, ""]  # of the model, as a part of that of nominal values

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Points":
        """On an image of `shape` pixels."""
        diameter = sensor.electrode_diameter
        sheet = model.Sheet(
            make_field(sensor),
            jnp.exp(jnp.mean(jnp.log(sensor.sheet_resistance))),
            sensor.ground_resistance,
            sensor.drive_voltage,
            _UNIT * diameter,
            _USUAL * diameter,
        )
        size = np.asarray(sensor.size)
        parts = (np.arange(_CANDIDATES) + 0.5) / _CANDIDATES
        grid = np.stack(np.meshgrid(parts, parts, indexing="ij"), -1).reshape(-1, 2)
        candidates = jnp.asarray(grid * size, sensor.dtype)
        each = jax.vmap(kernels.field_at, (None, 0, None))
        potentials = jax.jit(each)(sheet.field, candidates, sheet.size)
        cell = sensor.size / jnp.asarray(shape, sensor.dtype)
        noise, error = (jnp.asarray(a, sensor.dtype) for a in (NOISE, 1.0))
        xy = sensor.electrode_xy
        return cls(shape, cell, sheet, candidates, potentials, xy, noise, error)

    def calibrated(self, calibration: Calibration) -> "Points":
        noise = jnp.asarray(calibration.noise, self.noise.dtype)
        error = jnp.asarray(calibration.error, self.noise.dtype)
        ground = jnp.asarray(calibration.ground, self.noise.dtype)
        resistance = self.sheet.ground_resistance + ground
        sheet = self.sheet._replace(ground_resistance=resistance)
        return replace(self, sheet=sheet, noise=noise, error=error)

    @property
    def electrode_count(self) -> int:
        return self.potentials.shape[1]

    def choose_lambda(self, frames: list[Frame]) -> float:
        """The error of a sheet with nominal values."""
        return 1.0

    def scale(self) -> float:
        return 1.0

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> Prepared:
        used = _common(good)
        channels = np.asarray(used.any(0))
        xy = np.asarray(self.electrode_xy, float)
        slots = np.flatnonzero(used.any(1))
        compared = slots[np.linspace(0, len(slots) - 1, _SLOTS).round().astype(int)]
        if len(slots) <= _SLOTS:
            compared = slots
        dtype, own = self.cell.dtype, float(np.sqrt(lam))
        # A calibration tells of the sheet, not of what a contact's shape is beside a disc.
        spread = own * float(self.error)
        return Prepared(
            jnp.asarray(grounds, int),
            jnp.asarray(used),
            jnp.asarray(own * _OWN, dtype),
            jnp.asarray(own * _BEND * bends(xy, channels), dtype),
            spread * self.smooth(self.electrode_xy),
            jnp.asarray(spread, dtype),
            jnp.asarray(spread * _OFFSET, dtype),
            self.noise,
            jnp.asarray(compared),
        )

    def smooth(self, places: Float[Array, "n 2"]) -> Float[Array, "q n"]:
        """What neighbours' relative errors have in common, 1 σ of each wave."""
        modes, strength = smooth_modes(places, self.sheet.field.size)
        return modes * jnp.asarray(_SMOOTH * strength[:, None], modes.dtype)

    def estimate(
        self, prepared: Prepared, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        scene = scene_of(self, prepared, voltages, count)
        ladder = first(scene)
        for due, step in steps(count):
            ladder = jax.lax.cond(
                due(ladder), partial(step, scene), lambda found: found, ladder
            )
        return self._described(ladder.best)

    def block(
        self,
        prepared: Prepared,
        voltages: Float[Array, "n S M"],
        grounds: Integer[np.ndarray, "n S"],
        count: int,
        images: bool,
    ) -> tuple:
        """As `estimate`; a larger model is fitted only to the frames that ask for it."""
        under = jnp.asarray(grounds)
        blocks = [slice(k, k + _BLOCK) for k in range(0, len(voltages), _BLOCK)]
        parts = [_first(self, prepared, voltages[b], under[b], count) for b in blocks]
        ladder = jax.tree.map(lambda *p: np.concatenate(p), *parts)
        for number, (due, _) in enumerate(steps(count)):
            rest = np.flatnonzero(due(ladder))
            for k in range(0, len(rest), _BLOCK):
                rows = np.resize(rest[k : k + _BLOCK], _BLOCK)
                part = jax.tree.map(lambda a, rows=rows: a[rows], ladder)
                new = _step(
                    self, prepared, voltages[rows], under[rows], part, count, number
                )
                for old, values in zip(jax.tree.leaves(ladder), jax.tree.leaves(new)):
                    old[rows] = values
        rows = []
        for b in blocks:
            found = jax.tree.map(lambda a, b=b: a[b], ladder.best)
            rows.append(_described_all(self, found, voltages[b], count, images))
        return jax.tree.map(lambda *p: np.concatenate(p), *rows)

    def _described(self, found: Found) -> Estimate:
        contacts = kernels.points_as_contacts(
            found.count,
            found.place,
            found.extent,
            found.ring,
            found.radius,
            found.current,
            found.conductance,
            found.covariance,
        )
        image = kernels.points_image(
            found.place,
            found.extent,
            found.ring,
            found.radius,
            found.current,
            self.cell,
            self.shape,
        )
        flags = jnp.where(found.limited, kernels.Flag.MODEL_LIMITED.value, 0)
        # Of all channels together: what is left of a part of them is little of the whole.
        high = found.cost > TOLERANCE
        flags = flags | jnp.where(high, kernels.Flag.HIGH_RESIDUAL.value, 0)
        return Estimate(contacts, image, found.residual, flags)


def _common(good: Bool[np.ndarray, "S M"]) -> Bool[np.ndarray, "S M"]:
    """Slots by the channels that are good in all of them.

    One set of channels serves all slots; slots that have lost more than half of what the
    best has are left out for it.
    """
    each = good.sum(1)
    slots = each * 2 > each.max()
    channels = good[slots].all(0) if slots.any() else good.any(0)
    return slots[:, None] & channels


def bends(
    xy: Float[np.ndarray, "M 2"], channels: Bool[np.ndarray, " M"]
) -> Float[np.ndarray, "M M"]:
    """From voltages to how far each is from the plane through its neighbours'."""
    apart = np.sqrt(((xy[:, None] - xy) ** 2).sum(-1)) + np.diag(np.full(len(xy), np.inf))
    pitch = np.median(apart.min(1))
    matrix = np.zeros(apart.shape)
    for k in np.flatnonzero(channels):
        near = np.flatnonzero(channels & (apart[k] < 1.6 * pitch))
        if len(near) < 3:  # what is left of few: those that are nearest
            near = np.flatnonzero(channels)[np.argsort(apart[k, channels])[:4]]
            near = near[near != k]
        plane = np.column_stack([np.ones(len(near)), (xy[near] - xy[k]) / pitch])
        matrix[k, near] = -np.linalg.pinv(plane)[0]
        matrix[k, k] = 1
    return matrix


@eqx.filter_jit
def _first(method, prepared, voltages, grounds: Int[Array, "n S"], count: int) -> Ladder:
    def one(v: Array, grounds: Array) -> Ladder:
        return first(scene_of(method, prepared._replace(grounds=grounds), v, count))

    return jax.vmap(one)(voltages, grounds)


@eqx.filter_jit
def _step(
    method, prepared, voltages, grounds, ladder: Ladder, count: int, number: int
) -> Ladder:
    def one(v: Array, grounds: Array, ladder: Ladder) -> Ladder:
        scene = scene_of(method, prepared._replace(grounds=grounds), v, count)
        return steps(count)[number][1](scene, ladder=ladder)

    return jax.vmap(one)(voltages, grounds, ladder)


@eqx.filter_jit
def _described_all(method, found: Found, voltages, count: int, images: bool) -> tuple:
    def one(found: Found, v: Array) -> tuple:
        return judged(method, method._described(found), v, count, images)

    return jax.vmap(one)(found, voltages)
