"""Turns exploratory voltages into ground conditions: the paper's adaptive scan (II.D).

The functions have fixed output sizes, take any array of electrodes, and run inside a
compiled step. Bad voltages give a flag and a defined region, never an exception.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.flags import Flag

DIRECTIONS = 8  # classes over half a turn, 22.5° apart: class c is c·π/8

# Weights below this part of the highest are noise, and what the grounded electrodes leave
# on their neighbours; far from the contact they would turn its direction.
_LIGHT = 0.1

# Principal axes this close to each other (relative, of the variances) have no direction.
_ROUND = 0.05


class Region(NamedTuple):
    """The region that the object touches, as electrodes see it."""

    centre: Int[Array, ""]  # the electrode of the highest summed voltage
    inside: Bool[Array, " M"]  # electrodes within α of it
    low: Float[Array, "2"]  # bounding box of those, m
    high: Float[Array, "2"]
    direction: Float[Array, ""]  # principal direction, rad from x, in [0, π)
    direction_class: Int[Array, ""]  # its nearest of eight
    flags: Int[Array, ""]


def electrode_currents(
    resistances: Float[Array, "M M"], voltages: Float[Array, "E M"]
) -> Float[Array, " M"]:
    """Computes currents into electrodes that would make the summed exploratory voltages, A.

    The currents are R_ee⁺ΣV. Voltages are harmonic between contacts, so high currents are
    under the object. The grounded electrodes appear as sinks. The paper weighs the
    electrodes of a region equally; the currents show the region's shape between electrodes.
    """
    # Voltages have a free constant, R_ee none of its own: a constant is added to it.
    m = len(resistances)
    regular = resistances + jnp.mean(jnp.diagonal(resistances))
    summed = voltages.sum(0)
    currents = jnp.linalg.solve(regular, summed - summed.mean())
    return currents - currents.sum() / m


def contact_region(
    voltages: Float[Array, "E M"],
    electrode_xy: Float[Array, "M 2"],
    alpha: Float[Array, ""],
    threshold: Float[Array, ""],
    weights: Float[Array, " M"] | None = None,
) -> Region:
    """Finds the centre of contact, electrodes in contact, their box and main direction.

    **Arguments:** `voltages` of the E exploratory slots; `alpha` α, percent of the highest
    summed voltage; `threshold`: summed volts below which nothing touches; `weights`: each
    electrode's part in the principal direction, such as `electrode_currents`. Weights below
    a tenth of the highest do not count. By default all electrodes of the region weigh the
    same, as in the paper.

    Without a contact (or with bad voltages) the region is the electrode nearest to the
    middle of the array, without direction (class 0).
    """
    summed = voltages.sum(0)
    good = jnp.isfinite(voltages).all()
    touched = good & (summed.max() > threshold)
    middle = jnp.argmin(_steps_away(electrode_xy, electrode_xy.mean(0)))
    centre = jnp.where(touched, jnp.argmax(summed), middle)
    index = jnp.arange(len(electrode_xy))
    inside = jnp.where(touched, summed >= alpha / 100 * summed.max(), index == centre)
    low = jnp.where(inside[:, None], electrode_xy, jnp.inf).min(0)
    high = jnp.where(inside[:, None], electrode_xy, -jnp.inf).max(0)
    weight = inside.astype(electrode_xy.dtype)
    if weights is not None:
        heavy = jnp.where(weights > _LIGHT * weights.max(), weights, 0)
        weight = jnp.where(touched, heavy, weight)
    direction, lengthy = _principal_direction(weight, electrode_xy)
    step = jnp.pi / DIRECTIONS
    nearest = jnp.round(direction / step).astype(centre.dtype) % DIRECTIONS
    flags = (
        jnp.where(good & ~touched, Flag.NO_CONTACT.value, 0)
        + jnp.where(good, 0, Flag.BAD_VOLTAGES.value)
        + jnp.where(lengthy, 0, Flag.NO_DIRECTION.value)
        + jnp.where(inside.all(), Flag.WHOLE_SHEET.value, 0)
    )
    return Region(centre, inside, low, high, direction, nearest, flags)


def _principal_direction(weight: Array, xy: Array) -> tuple[Array, Array]:
    """Computes the longer principal axis's angle (0 if none), and whether one exists."""
    w = weight / weight.sum()
    away = xy - w @ xy
    xx, yy, cross = w @ away[:, 0] ** 2, w @ away[:, 1] ** 2, w @ (away[:, 0] * away[:, 1])
    unequal = jnp.hypot(xx - yy, 2 * cross)
    lengthy = unequal > _ROUND * (xx + yy)
    # Half the angle of (xx − yy, 2·cross), with a harmless argument where it has none.
    angle = jnp.arctan2(2 * cross, jnp.where(lengthy, xx - yy, 1)) / 2
    return jnp.where(lengthy, angle % jnp.pi, 0), lengthy


def contact_regions(
    voltages: Float[Array, "E M"],
    electrode_xy: Float[Array, "M 2"],
    currents: Float[Array, " M"],
    threshold: Float[Array, ""],
    count: int,
) -> Region:
    """Finds up to `count` separate contacts, strongest first, as a `Region` of (count, …).

    A contact is a group of neighbouring electrodes (within 1.5 pitches). The group's
    `electrode_currents` are above a quarter of the group's highest. That highest current is
    above a quarter of the highest of all. Rows without a contact have the flag NO_CONTACT.
    """
    summed = voltages.sum(0)
    good = jnp.isfinite(voltages).all()
    square = jnp.sum((electrode_xy[:, None] - electrode_xy) ** 2, -1)
    touching = square < (1.5 * smallest_pitch(electrode_xy)) ** 2

    def take(free: Array, _) -> tuple[Array, Region]:
        left = jnp.where(free, currents, 0)
        peak = jnp.argmax(left)
        index = jnp.arange(len(electrode_xy))
        found = good & (left[peak] > currents.max() / 4) & (summed.max() > threshold)
        allowed = free & (currents > left[peak] / 4)

        def spread(_, group: Array) -> Array:
            return (touching & group).any(1) & allowed

        group = lax.fori_loop(0, len(electrode_xy), spread, index == peak)
        # The voltages of this group alone, with all of it inside.
        alone = jnp.where(group & found, jnp.maximum(currents, 0), 0)
        region = contact_region(
            alone[None], electrode_xy, jnp.full_like(threshold, 25), 0 * threshold, alone
        )
        bad = jnp.where(good, 0, Flag.BAD_VOLTAGES.value)
        return free & ~group, region._replace(flags=region.flags | bad)

    return lax.scan(take, jnp.ones_like(summed, bool), length=count)[1]


def smallest_pitch(electrode_xy: Float[Array, "M 2"]) -> Float[Array, ""]:
    """Computes the smallest distance between two electrodes, m."""
    square = jnp.sum((electrode_xy[:, None] - electrode_xy) ** 2, -1)
    apart = jnp.where(jnp.eye(len(square), dtype=bool), jnp.inf, square)
    return jnp.sqrt(apart.min())


def around(
    region: Region, ground_xy: Float[Array, "L 2"], pitch: Float[Array, ""]
) -> Int[Array, " n"]:
    """Picks *Around*: corners and side midpoints of the region's box, as eight grounds.

    The box is at least two `pitch` wide, so that the eight differ, and is moved inside the
    array. Each corner or midpoint takes the nearest ground not yet taken. All grounds are
    taken if there are fewer than eight.
    """
    size = jnp.maximum(region.high - region.low, 2 * pitch)
    low, high = ground_xy.min(0), ground_xy.max(0)
    size = jnp.minimum(size, high - low)
    centre = jnp.clip((region.low + region.high) / 2, low + size / 2, high - size / 2)
    steps = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
    targets = centre + jnp.asarray(steps, size.dtype) * size / 2
    return nearest_electrodes(targets[: len(ground_xy)], ground_xy)


def _steps_away(electrode_xy: Array, target: Array) -> Float[Array, " M"]:
    """Computes squared distances in whole steps: rounding decides between no two."""
    step = 1e-4 * smallest_pitch(electrode_xy) ** 2
    return jnp.round(jnp.sum((electrode_xy - target) ** 2, 1) / step)


def nearest_electrodes(
    targets: Float[Array, "T 2"], electrode_xy: Float[Array, "M 2"]
) -> Int[Array, " T"]:
    """Picks for each target in turn the nearest electrode not yet taken.

    Of two that are equally near it is the first.
    """

    def take(free: Array, target: Array) -> tuple[Array, Array]:
        away = _steps_away(electrode_xy, target)
        chosen = jnp.argmin(jnp.where(free, away, jnp.inf))
        return free.at[chosen].set(False), chosen

    return lax.scan(take, jnp.ones(len(electrode_xy), bool), targets)[1]


def cop_line(
    region: Region,
    ground_xy: Float[Array, "L 2"],
    centre: Float[Array, "2"],
    pitch: Float[Array, ""],
) -> Int[Array, " n"]:
    """Picks *CoP line*: eight grounds along the direction class through the `centre`.

    Grounds within half a pitch of the line come first, nearest to the centre first. If
    these are too few, grounds of the perpendicular line follow, then the nearest others.
    """
    angle = region.direction_class.astype(ground_xy.dtype) * (jnp.pi / DIRECTIONS)
    along = jnp.stack([jnp.cos(angle), jnp.sin(angle)]).astype(ground_xy.dtype)
    away = ground_xy - centre
    on_line = matmul(away, along)
    across = away[:, 1] * along[0] - away[:, 0] * along[1]
    reach = 0.5 * pitch * (1 - 1e-3)  # half-way between two lines is neither
    tier = jnp.where(
        jnp.abs(across) <= reach, 0, jnp.where(jnp.abs(on_line) <= reach, 1, 2)
    )
    distance = jnp.sqrt(jnp.sum(away**2, 1))
    # Rounding must not decide between the electrodes on either side of the centre.
    order = jnp.round(distance / (1e-3 * reach)) + tier * 1e6
    return jnp.argsort(order, stable=True)[:8]


def point(voltages: Float[Array, "E M"], corners: Int[Array, "4"]) -> Int[Array, "6"]:
    """Picks *Point*: the four corners and the two other electrodes nearest to the contact.

    The nearest electrodes have the highest summed voltage; NaN counts as lowest.
    """
    summed = jnp.nan_to_num(voltages.sum(0), nan=-jnp.inf)
    two = jnp.argsort(-summed.at[corners].set(-jnp.inf), stable=True)[:2]
    return jnp.concatenate([corners.astype(two.dtype), two])
