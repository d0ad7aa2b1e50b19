"""Models contacts about as long as wide by patches, whose currents the sheet decides.

`discs` spreads a contact's current evenly, and leans it to one side. Under metal that lies
on an electrode in part the current goes elsewhere: to the electrode's rim, and round it.
Here a contact is a cloud of patches of one conductance each, and their shares of the
current solve the sheet's own equations, slot by slot. A place is then off by a twentieth of
a millimetre where discs are off by a half.
"""

from typing import cast, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.algebra import solve_positive
from tomojax.kernels.contacts._discs import chain_of, priors_of
from tomojax.kernels.contacts._equations import (
    best_currents,
    currents_of,
    Explained,
    made_by,
    whitened_rows,
    WhitenedFrame,
)
from tomojax.kernels.contacts._field import home_of, rows_at
from tomojax.kernels.contacts._near import fields_about, nearest, Near, rows_near
from tomojax.kernels.contacts._points import (
    DISC,
    drops,
    Fitted,
    green_of,
    LEAST_DROP,
    LONG,
    Sheet,
    slope_of,
    unpack,
)

# Rings of patches around the middle one: 1 + 6 + 12.
_RINGS = 2

# Points of a patch that the fields beside electrodes are averaged over.
_POINTS = 7

# Passes that a contact's conductance and its current's shape agree after.
_PASSES = 3

# How well a slot's level is known, 1 σ, of the drive. The level tells a contact's drop and
# so its conductance; of metal, whose drop is small, the currents' shape tells more.
_LEVEL = 0.05

# The induced current's middle stays within this part of the radius.
_FARTHEST = 0.6


def _rings(count: int) -> Float[np.ndarray, "n 2"]:
    """Places patches of equal area on a unit disc; second moments are an even disc's."""
    n, inner, found = 1 + 3 * count * (count + 1), 1, [np.zeros((1, 2))]
    for k in range(1, count + 1):
        square = (inner + 3 * k) / n
        turn = 2 * np.pi * (np.arange(6 * k) + k % 2 / 2) / (6 * k)
        found.append(np.sqrt(square) * np.stack([np.cos(turn), np.sin(turn)], 1))
        inner += 6 * k
    return np.concatenate(found)


_CLOUD = _rings(_RINGS)
_EACH = _rings(1) / np.sqrt(len(_CLOUD))


class _Cloud(NamedTuple):
    """A contact's n patches."""

    off: Float[Array, "n 2"]  # from its middle, m
    rows: Float[Array, "n M"]  # R_e, Ω
    plane: Float[Array, "n n"]  # between patches, but for what all have in common, Ω
    taken: Float[Array, "n n"]  # of this by electrodes' discs, Ω


class _Given(NamedTuple):
    """What one contact's shares depend on beside its own place and shape."""

    own: Float[Array, ""]  # n/g: resistance of a patch, Ω
    more: Float[Array, " S"]  # the slot's whole current, of the contact's own
    slope: Float[Array, "S 2"]  # of the sheet's potential by contacts, edges: Ω/m, the same
    radius: Float[Array, ""]


def patches(
    sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, " P"]
) -> Explained:
    """Explains a frame as `discs` does, by as many parameters.

    A patch at x_i with q_i/(g/n) = V0 − u(x_i) and the slot's whole current I has

        Σ_j G_ij q_j + (n/g)·q_i = const + I·R_l(x_i) − Σ_c E_c·(x_i − x),

    E_c the slope that edges and other contacts make. Currents of contacts stay free, as in
    `discs`; the equations give their shares alone.
    """
    parameters = parameters.reshape(-1, DISC)
    cloud = jax.vmap(lambda p: _cloud(sheet, p))(parameters)
    place, radius = unpack(sheet, parameters)
    moment = LONG * sheet.size**2 * parameters[:, 3:5]
    table = jax.vmap(rows_at, (None, 0, 0, 0))(sheet.field, place, radius, moment)
    even = table[:, 0]
    slots, offset = sheet.slots, sheet.slots.offset(frame.grounds)
    columns = slots.relative(even, frame.grounds).swapaxes(0, 1) + offset[:, None]
    current = currents_of(whitened_rows(frame, columns), frame.whitened)
    flowing = made_by(current, columns)
    given, drop, told = _given(sheet, frame, cloud, parameters, even, current, flowing)

    def one(p: Float[Array, "6"], given: _Given) -> Float[Array, "S M"]:
        cloud, own = _cloud(sheet, p), given.own * jnp.exp(-p[5])
        given = given._replace(own=own)
        sunk = slots.sunk(cloud.rows, frame.grounds, flowing)
        uneven = _shares(cloud, given, sunk) - 1 / len(cloud.off)
        return jnp.matmul(uneven, cloud.rows, precision="highest")

    def turned(p: Array, given: _Given) -> tuple[Array, Array]:
        moved = lambda t: jax.jvp(lambda p: one(p, given), (p,), (t,))  # noqa: E731
        return jax.vmap(moved, out_axes=(None, 0))(jnp.eye(DISC, dtype=p.dtype))

    rows, slopes = jax.vmap(turned)(parameters, given)  # (C, S, M), (C, 6, S, M)
    by_table = table[:, 1:DISC] * chain_of(sheet, parameters, radius)[:, : DISC - 1, None]
    slopes = slopes.at[:, : DISC - 1].add(by_table[:, :, None])
    rows = rows + even[:, None]
    columns = slots.apart(rows.swapaxes(0, 1), frame.grounds) + offset[:, None]
    column = whitened_rows(frame, columns)
    current, rest = best_currents(column, frame.whitened)
    tangent = slots.apart(jnp.moveaxis(slopes, 2, 0), frame.grounds)
    tangent = (tangent * current[..., None, None]).reshape(len(current), -1, even.shape[1])
    prior, by_parameter = priors_of(parameters, told)
    none = jnp.zeros_like(place)
    at = jax.vmap(home_of, (None, 0))(sheet.field, place)
    volts = made_by(current, columns)
    fitted = Fitted(at, none, none[:, 0], radius, current, drop, volts)
    tangent = whitened_rows(frame, tangent)
    return Explained(rest, column, tangent, prior, by_parameter, fitted)


def _cloud(sheet: Sheet, parameters: Float[Array, "6"]) -> _Cloud:
    """Puts patches on an ellipse with the disc's area and the moments (a² − b²)/8."""
    near, dtype = cast(Near, sheet.near), parameters.dtype
    (place,), (radius,) = unpack(sheet, parameters[None])
    half = 4 * LONG * sheet.size**2 * parameters[3:5]
    square = jnp.sqrt(radius**4 + (half**2).sum())
    xx, yy, xy = square + half[0], square - half[0], half[1]
    root = jnp.sqrt(2 * (square + radius**2))
    both = jnp.stack([xx + radius**2, xy, xy, yy + radius**2]).reshape(2, 2) / root
    off, each = (
        jnp.matmul(jnp.asarray(a, dtype), both, precision="highest")
        for a in (_CLOUD, _EACH)
    )
    size = sheet.field.size
    at = size - jnp.abs(size - jnp.abs(place + off) % (2 * size))
    own = nearest(near, at)
    away = at - near.electrodes[own]
    about = fields_about(near.radius, near.reach, away[:, None] + each)
    log, dipole = (a.mean(1) for a in about)
    rows = rows_near(near, size, at, own, log, dipole)
    return _Cloud(off, rows, *_among(sheet, at, radius))


def _images(sheet: Sheet, at: Float[Array, "n 2"]) -> Float[Array, "k n 2"]:
    """Returns places, then their nearest images at the edges; of skins places alone."""
    if sheet.field.among is not None:
        return at[None]
    one = jnp.stack([at, -at, 2 * sheet.field.size - at])  # of each coordinate
    x, y = np.divmod(np.arange(9), 3)
    return jnp.stack([one[x, :, 0], one[y, :, 1]], -1)


def _steep(sheet: Sheet, place: Float[Array, "C 2"], radius: Array) -> Float[Array, "C C 2"]:
    """Computes ∇ at each place of one ampere into each contact, but for a place's images.

    Images of a contact's own patches are among the patches' potentials.
    """
    away = place - _images(sheet, place)[1:]
    square = jnp.maximum((away**2).sum(-1, keepdims=True), radius[:, None] ** 2)
    images = -cast(Near, sheet.near).feed * (away / square).sum(0)
    own = jnp.eye(len(place), dtype=place.dtype)[..., None]
    return slope_of(sheet, place, radius) - own * images


def _among(sheet: Sheet, at: Array, radius: Array) -> tuple[Array, Array]:
    """Computes potentials between patches, Ω: of the sheet, and what metal discs take.

    Edges of a rectangle mirror the patches; the nearest images count. What all patches have
    in common is left out.
    """
    near, size, images = cast(Near, sheet.near), sheet.field.size, _images(sheet, at)
    rim = radius / float(np.sqrt(len(at)) * np.exp(0.25))
    square = ((at[:, None] - images[:, None]) ** 2).sum(-1)
    # Units of length beyond all distances keep the matrix positive.
    unit = jnp.where(jnp.arange(len(images)) == 0, 6 * radius, 3 * size.max())
    plane = -jnp.log(jnp.maximum(square, rim**2) / unit[:, None, None] ** 2).sum(0) / 2
    away = images[:, :, None] - near.electrodes
    field = away / jnp.maximum((away**2).sum(-1, keepdims=True), near.radius**2)
    field = field.sum(0).reshape(len(at), -1)
    taken = jnp.matmul(field, field.T, precision="highest")
    # The shares' slopes by a contact's place come from the grounds' potentials alone.
    found = near.feed * plane, near.feed * near.answer * near.radius**2 * taken
    return jax.lax.stop_gradient(found)


def _shares(
    cloud: _Cloud, given: _Given, sunk: Float[Array, "n S"]
) -> Float[Array, "S n"]:
    """Solves the patches' equations: shares of the contact's current, with sum 1."""
    induced = sunk * given.more - jnp.matmul(cloud.off, given.slope.T, precision="highest")
    n = len(cloud.off)
    right = jnp.concatenate([jnp.ones_like(induced[:, :1]), induced], 1)
    matrix = cloud.plane - cloud.taken + given.own * jnp.eye(n, dtype=right.dtype)
    found = solve_positive(matrix, right)
    base = found[:, :1] / found[:, :1].sum()
    uneven = found[:, 1:] - base * found[:, 1:].sum(0)
    shift = jnp.matmul(uneven.T, cloud.off, precision="highest")
    length = jnp.sqrt((shift**2).sum(-1) + 1e-18)
    uneven = uneven * jnp.minimum(1, _FARTHEST * given.radius / length)
    return (base + uneven).T


def _given(
    sheet: Sheet,
    frame: WhitenedFrame,
    cloud: _Cloud,
    parameters: Float[Array, "C 6"],
    even: Float[Array, "C M"],
    current: Float[Array, "S C"],
    flowing: Float[Array, "S M"],
) -> tuple[_Given, Float[Array, "S C"], Float[Array, " C"]]:
    """Finds each contact's conductance, and what else its shares depend on; and drops.

    An even contact's drop V0 − u comes first. Its current then moves to where the sheet
    takes more of it, and the contact's mean potential falls.
    """
    place, radius = unpack(sheet, parameters)
    n = cloud.off.shape[1]
    forward = jnp.sign(sheet.drive_voltage)
    least = LEAST_DROP * jnp.abs(sheet.drive_voltage)
    among = jax.vmap(green_of(sheet, place, radius))(place)
    steep = _steep(sheet, place, radius)
    sunk = sheet.slots.sunk(cloud.rows, frame.grounds, flowing)  # (C, n, S)
    level = sheet.slots.level(cloud.rows, frame.grounds)
    offset = sheet.slots.offset(frame.grounds)[:, None]

    def about(own: Array, current: Array) -> _Given:
        enough = 1e-4 * jnp.abs(current).sum(1, keepdims=True) + 1e-15
        safe = jnp.where(jnp.abs(current) > enough, current, jnp.inf)
        slope = jnp.einsum("sd,cdk->sck", current, steep, precision="highest")
        slope = jnp.moveaxis(slope / safe[..., None], 1, 0)
        return _Given(own, (current.sum(1, keepdims=True) / safe).T, slope, radius)

    def dropped(current: Array, shares: Array) -> Array:
        mean = level.mean(1).T, sunk.mean(1).T
        drop = drops(sheet, frame.grounds, among, *mean, current)
        return drop - current * _fallen(cloud, shares, level).T

    def own_of(current: Array, drop: Array) -> Array:
        through = (forward * current).mean(0)
        through = jnp.maximum(through, 1e-6 * least / sheet.sheet_resistance)
        return n * jnp.maximum((forward * drop).mean(0), least) / through

    def agreed(_: int, now: tuple[Array, Array]) -> tuple[Array, Array]:
        own, current = now
        given = about(own * jnp.exp(-parameters[:, 5]), current)
        shares = jax.vmap(_shares)(cloud, given, sunk)
        rows = jnp.matmul(shares - 1 / n, cloud.rows, precision="highest")
        rows = rows.swapaxes(0, 1) + even
        column = sheet.slots.apart(rows, frame.grounds) + offset
        current = currents_of(whitened_rows(frame, column), frame.whitened)
        return own_of(current, dropped(current, shares)), current

    flat = jnp.full((len(place), len(current), n), 1 / n, current.dtype)
    first = own_of(current, dropped(current, flat)), current
    own, current = jax.lax.fori_loop(0, _PASSES, agreed, first)
    given = about(own, current)
    shares = jax.vmap(_shares)(
        cloud, given._replace(own=own * jnp.exp(-parameters[:, 5])), sunk
    )
    drop = dropped(current, shares)
    told = jnp.maximum((forward * drop).mean(0), least) / (_LEVEL * forward * sheet.drive_voltage)
    return *jax.lax.stop_gradient((given, drop)), jax.lax.stop_gradient(told)


def _fallen(cloud: _Cloud, shares: Array, level: Array) -> Float[Array, "C S"]:
    """Computes how much an even current's mean potential differs for these shares, Ω."""
    uneven = shares - 1 / shares.shape[-1]
    own = jnp.einsum("csj,cij->cs", uneven, cloud.plane)
    own = own - jnp.einsum("csj,cij->cs", shares, cloud.taken)
    return own / shares.shape[-1] - jnp.einsum("csj,cjs->cs", uneven, level)
