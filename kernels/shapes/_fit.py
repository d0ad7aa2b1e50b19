"""Fits a field of two levels to a frame's voltages: Gauss and Newton's steps, exact model.

min over w of  t·Σ_s δ²·ln(1 + |r_s(g)|²/δ²) + |w|²,  g = level·(the part that touches)

r_s are a slot's whitened residuals. Most errors are the model's (a sheet that is not even,
electrodes off their places), and the same in all slots. So t is below 1 where slots are
many.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import descended, matmul
from tomojax.kernels.contacts import whitened_columns, whitened_slopes, WhitenedFrame
from tomojax.kernels.shapes._field import touching, TwoLevels
from tomojax.kernels.sheet import (
    ContactReduction,
    ground_voltages,
    reduce_sites,
    Slots,
    voltage_slopes,
)

# Slopes are made of so many pixels,
_SOME = 384
# where all other pixels have no more than this part of the slopes.
_LEFT = 2e-3

# The largest change of f in one step: beyond, the slopes say nothing.
_LONGEST = 6.0


class PixelSites(NamedTuple):
    """Resistances between pixels and electrodes, and the sites that each pixel touches."""

    table: Float[Array, "sites sites"]  # Ω, electrodes last
    on_sheet: Float[Array, " pixels"]  # the part of a pixel that is on no electrode
    metal: Float[Array, "pixels M"]  # and the part on each

    def of(self, pixels: Float[Array, "pixels ..."]) -> Float[Array, "sites ..."]:
        """Turns values of pixels into values of their sites and the electrodes' metal."""
        on_sheet = self.on_sheet.reshape((-1,) + (1,) * (pixels.ndim - 1))
        return jnp.concatenate([pixels * on_sheet, matmul(self.metal.T, pixels)])


class Told(NamedTuple):
    """A frame's voltages, their errors, and the rig's values."""

    voltages: Float[Array, "S M"]
    frame: WhitenedFrame
    tolerance: Float[Array, ""]  # δ²
    part: Float[Array, ""]  # t
    slots: Slots
    drive_voltage: Float[Array, ""]  # V


class Scene(NamedTuple):
    """A field of n pixels, the sites under them, and the frame that it is fitted to."""

    field: TwoLevels
    sites: PixelSites
    told: Told
    level: Float[Array, " n"]  # S of a pixel that touches


class Evaluated(NamedTuple):
    """The model's state at some w."""

    rest: Float[Array, "S W"]
    contact: ContactReduction


class ShapeFit(NamedTuple):
    """The end of a fit."""

    w: Float[Array, " K"]
    touch: Float[Array, " n"]  # the part of each pixel that touches
    misfits: Float[Array, " S"]  # |r_s|²
    cost: Float[Array, ""]  # with the field's own
    at: Evaluated


def fit_shape(
    scene: Scene, start: Float[Array, " K"], most: int, enough: float
) -> ShapeFit:
    """Finds the likeliest field, from `start`.

    The fit ends after `most` evaluations, or once a step gains less than the part `enough`.
    """
    field, sites, told, level = scene

    def evaluated(w: Array) -> tuple[Array, Evaluated]:
        touch, _ = touching(field.waves, field.mean, w)
        contact = reduce_sites(sites.table, sites.of(level * touch), sites.metal.shape[1])
        rest = _rest(told, contact)
        cost = told.part * told.tolerance * jnp.log1p((rest**2).sum(1) / told.tolerance)
        return cost.sum() + (w**2).sum(), Evaluated(rest, contact)

    def move_from(w: Array, at: Evaluated) -> Array:
        _, steep = touching(field.waves, field.mean, w)
        slopes = shape_slopes(scene, steep, at)
        matrix, uphill = _equations(told, slopes, at.rest)
        unit = jnp.eye(len(w), dtype=w.dtype)
        move = -cho_solve((jnp.linalg.cholesky(matrix + unit), True), uphill + w)
        change = jnp.abs(matmul(field.waves, move)).max()
        return move * jnp.minimum(1, _LONGEST / jnp.maximum(change, _LONGEST / 100))

    run = descended(evaluated, move_from, start, most, enough)
    at: Any = run.state
    touch, _ = touching(field.waves, field.mean, run.w)
    return ShapeFit(run.w, touch, (at.rest**2).sum(1), run.cost, at)


def followed(scene: Scene, fit: ShapeFit) -> ShapeFit:
    """Gives a fit derivatives by `told`: those of the place where the fit ends.

    At the end JᵀWr + w = 0, and so dw = −(I + JᵀWJ)⁻¹JᵀW dr: the derivative does not follow
    the fit's steps. W, J and the level stay as they are.
    """
    fixed: Any = jax.lax.stop_gradient((scene, fit))
    (field, _, still, _), fit = fixed
    _, steep = touching(field.waves, field.mean, fit.w)
    slopes = shape_slopes(fixed[0], steep, fit.at)
    matrix, _ = _equations(still, slopes, fit.at.rest)
    unit = jnp.eye(len(fit.w), dtype=fit.w.dtype)
    rest = _rest(scene.told, fit.at.contact)
    change = rest - jax.lax.stop_gradient(rest)
    weight = still.part / (1 + fit.misfits / still.tolerance)
    uphill = jnp.einsum("s,sw,swk->k", weight, change, slopes, precision="highest")
    w = fit.w - cho_solve((jnp.linalg.cholesky(matrix + unit), True), uphill)
    touch, _ = touching(field.waves, field.mean, w)
    return fit._replace(w=w, touch=touch)


def shape_slopes(
    scene: Scene, steep: Float[Array, "n q"], at: Evaluated
) -> Float[Array, "S W K"]:
    """Computes slopes of the whitened residuals by w; `steep`: slopes of touch by f."""
    field, sites, told, level = scene
    n = len(level)
    of_slots = told.slots, told.frame.grounds, told.drive_voltage
    slopes = voltage_slopes(at.contact, *of_slots)
    electrodes = sites.metal.shape[1]

    def of(pixels: Array) -> Array:
        here = (level[:, None] * steep)[pixels]
        # Not as products of matrices: XLA makes those one by one.
        each = (field.waves[pixels] * here[:, :, None]).sum(1)
        on_sheet = sites.on_sheet[pixels, None] * each
        metal = matmul(sites.metal[pixels].T, each)
        numbers = jnp.arange(n, n + electrodes, dtype=pixels.dtype)
        both = jnp.concatenate([on_sheet, metal]), jnp.concatenate([pixels, numbers])
        return slopes(*both)

    some = min(_SOME, n)
    weight = level * steep.sum(1)
    _, order = lax.top_k(weight, some)
    beyond = weight.sum() - weight[order].sum()
    few = beyond <= _LEFT * weight.sum()
    every = jnp.arange(n, dtype=order.dtype)
    volts = lax.cond(few, lambda: of(order), lambda: of(every))
    return whitened_slopes(told.frame, volts)


def shape_curvature(scene: Scene, fit: ShapeFit) -> Float[Array, "K K"]:
    """Computes t·JᵀWJ, the data's part of the inverse covariance of w; the prior adds I.

    The question is whether a pixel touches, which a tangent does not tell. Far from f = 0
    the logistic function is flat, and any f would do. So slopes are those of the chord to f
    = 0.
    """
    field = scene.field
    f = field.mean + matmul(field.waves, fit.w)
    small = jnp.abs(f) < 1e-2
    chord = jnp.where(small, 0.25, (jax.nn.sigmoid(f) - 0.5) / jnp.where(small, 1, f))
    slopes = shape_slopes(scene, chord / f.shape[1], fit.at)
    return _equations(scene.told, slopes, fit.at.rest)[0]


def _rest(told: Told, contact: ContactReduction) -> Float[Array, "S W"]:
    """Computes what a contact leaves of the voltages, whitened."""
    volts = ground_voltages(contact, told.slots, told.frame.grounds, told.drive_voltage)
    return whitened_columns(told.frame, volts - told.voltages)


def _equations(
    told: Told, slopes: Float[Array, "S W K"], rest: Float[Array, "S W"]
) -> tuple[Float[Array, "K K"], Float[Array, " K"]]:
    # Cauchy's loss: slots that do not fit at all count little.
    weight = told.part / (1 + (rest**2).sum(1) / told.tolerance)
    root = jnp.sqrt(weight)[:, None]
    flat = (root[:, :, None] * slopes).reshape(-1, slopes.shape[2])
    return matmul(flat.T, flat), matmul((root * rest).ravel(), flat)
