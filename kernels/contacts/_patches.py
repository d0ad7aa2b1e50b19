"""Models contacts about as long as wide by patches, whose currents the sheet decides.

`discs` spreads a contact's current evenly, and leans it to one side. Under metal that lies
on an electrode in part the current goes elsewhere: to the electrode's rim, and round it.
Here a contact is a cloud of patches of one conductance each, and their shares of the
current solve the sheet's own equations, slot by slot.
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
from tomojax.kernels.contacts._near import Near, rows_near
from tomojax.kernels.contacts._points import (
    DISC,
    drops,
    Fitted,
    green_of,
    LEAST_DROP,
    LONG,
    Sheet,
    SIZE_WIDTH,
    slope_of,
    unpack,
)

# Rings of patches around the middle one: 1 + 6 + 12.
_RINGS = 2

# Electrodes whose metal patches tell from each other; for further ones they are one place.
_BESIDE = 8

# Passes in which a contact's conductance and its current's shape come to agree.
_PASSES = 1

# How well a slot's level is known, 1 σ, of the drive. The level tells a contact's drop and
# so its conductance; of metal, whose drop is small, the current's shape tells more.
_LEVEL = 0.05

# The middle of the current that the sheet induces stays within this part of the radius.
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
_COUNT = len(_CLOUD)

# Points of a patch that fields beside electrodes are averaged over.
_EACH = _rings(1) / np.sqrt(_COUNT)


class _Cloud(NamedTuple):
    """A contact's n patches."""

    off: Float[Array, "n 2"]  # from its middle, m
    moves: Float[Array, "n 2 3"]  # of that by size and lengths, m
    rows: Float[Array, "n 3 M"]  # R_e, Ω, and slopes by x and y, Ω/m
    plane: Float[Array, "n n"]  # potentials between patches, but for what all share, Ω
    taken: Float[Array, "n n"]  # of these by electrodes' metal, Ω


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

    A patch at x_i with q_i = (g/n)(V0 − u(x_i)) and the slot's whole current I has

        Σ_j G_ij q_j + (n/g)·q_i = const + I·R_l(x_i) − E·(x_i − x),

    E the slope that far edges and other contacts make. Contacts' currents stay free: the
    equations give their shares alone. An even contact's potentials come from the table; the
    patches add what is uneven.
    """
    parameters = parameters.reshape(-1, DISC)
    place, radius = unpack(sheet, parameters)
    moment = LONG * sheet.size**2 * parameters[:, 3:5]
    table = jax.vmap(rows_at, (None, 0, 0, 0))(sheet.field, place, radius, moment)
    cloud = jax.vmap(_cloud, (None, 0, 0, 0))(sheet, place, radius, parameters)
    slots, offset = sheet.slots, sheet.slots.offset(frame.grounds)[:, None]

    def columns_of(uneven: Float[Array, "C S n"]) -> Float[Array, "S C M"]:
        rows = _product("csn,cnm->scm", uneven, cloud.rows[:, :, 0]) + table[:, 0]
        return slots.apart(rows, frame.grounds) + offset

    count, kinds = len(place), len(frame.grounds)
    even = columns_of(jnp.zeros((count, kinds, _COUNT), place.dtype))
    current = currents_of(whitened_rows(frame, even), frame.whitened)
    leaving = slots.sunk(cloud.rows, frame.grounds, made_by(current, even))  # (C, n, 3, S)
    about = _Slots(sheet, frame, cloud, place, radius, leaving[:, :, 0])
    given, drop = about.agreed(parameters[:, 5], current, columns_of)
    shares, inverse = jax.vmap(_shares)(cloud, given, leaving[:, :, 0])
    columns = columns_of(shares - 1 / _COUNT)
    current, rest = best_currents(whitened_rows(frame, columns), frame.whitened)
    chain = chain_of(sheet, parameters, radius)[:, : DISC - 1]
    moving = jax.vmap(_moving)(cloud, given, leaving, shares, inverse, chain[:, :2])
    by_table = table[:, 1:DISC] * chain[..., None]
    slopes = jnp.moveaxis(jnp.pad(by_table, ((0, 0), (0, 1), (0, 0)))[:, None] + moving, 1, 0)
    tangent = slots.apart(slopes, frame.grounds) * current[..., None, None]
    tangent = whitened_rows(frame, tangent.reshape(kinds, count * DISC, -1))
    forward = jnp.sign(sheet.drive_voltage)
    least = LEAST_DROP * jnp.abs(sheet.drive_voltage)
    told = jnp.maximum((forward * drop).mean(0), least)
    told = jax.lax.stop_gradient(told / (_LEVEL * jnp.abs(sheet.drive_voltage)))
    prior, by_parameter = priors_of(parameters, told)
    none = jnp.zeros_like(place)
    at = jax.vmap(home_of, (None, 0))(sheet.field, place)
    volts = made_by(current, columns)
    fitted = Fitted(at, none, none[:, 0], radius, current, drop, volts)
    column = whitened_rows(frame, columns)
    return Explained(rest, column, tangent, prior, by_parameter, fitted)


def _product(how: str, *arrays: Array) -> Array:
    return jnp.einsum(how, *arrays, precision="highest")


def _cloud(sheet: Sheet, place: Array, radius: Array, parameters: Array) -> _Cloud:
    """Puts patches on an ellipse with the disc's area and the moments (a² − b²)/8."""
    near, size = cast(Near, sheet.near), sheet.field.size

    def root(p: Float[Array, "3"]) -> Float[Array, "2 2"]:
        # The root of four times the even ellipse's second moments.
        a = radius * jnp.exp(SIZE_WIDTH * (p[0] - parameters[2]))
        half = 4 * LONG * sheet.size**2 * p[1:]
        square = jnp.sqrt(a**4 + (half**2).sum())
        xx, yy = square + half[0] + a**2, square - half[0] + a**2
        both = jnp.stack([xx, half[1], half[1], yy]).reshape(2, 2)
        return both / jnp.sqrt(2 * (square + a**2))

    shape = parameters[2:5]
    unit, each = (jnp.asarray(a, place.dtype) for a in (_CLOUD, _EACH))
    off, each = (_product("nk,kj->nj", a, root(shape)) for a in (unit, each))
    moves = _product("nk,kjp->njp", unit, jax.jacfwd(root)(shape))
    at = size - jnp.abs(size - jnp.abs(place + off) % (2 * size))
    rows = rows_near(near, size, at, each)
    found = _Cloud(off, moves, rows, *_among(sheet, place, at, radius))
    # Slopes are added up below.
    return jax.lax.stop_gradient(found)


def _images(sheet: Sheet, at: Float[Array, "n 2"]) -> Float[Array, "k n 2"]:
    """Returns places, then their nearest images at the edges; of skins places alone."""
    if sheet.field.among is not None:
        return at[None]
    one = jnp.stack([at, -at, 2 * sheet.field.size - at])  # of each coordinate
    x, y = np.divmod(np.arange(9), 3)
    return jnp.stack([one[x, :, 0], one[y, :, 1]], -1)


def _among(sheet: Sheet, place: Array, at: Array, radius: Array) -> tuple[Array, Array]:
    """Computes potentials between patches, Ω: of the sheet, and what metal takes of them.

    Edges mirror the patches, and electrodes' metal answers them with dipoles.
    """
    near, images = cast(Near, sheet.near), _images(sheet, at)
    rim = radius / float(np.sqrt(_COUNT) * np.exp(0.25))
    square = ((at[:, None] - images[:, None]) ** 2).sum(-1)
    # Units of length beyond all distances keep the matrix positive.
    unit = jnp.where(jnp.arange(len(images)) == 0, 6 * radius, 3 * sheet.field.size.max())
    ratio = jnp.maximum(square, rim**2) / unit[:, None, None] ** 2
    plane = -jnp.log(jnp.prod(ratio, 0)) / 2

    def field(images: Array, electrodes: Array) -> Array:
        away = images[:, :, None] - electrodes
        square = jnp.maximum((away**2).sum(-1, keepdims=True), near.radius**2)
        return (away / square).sum(0).reshape(images.shape[1], -1)

    one = field(_images(sheet, place[None]), near.electrodes)
    far = ((place - near.electrodes) ** 2).sum(-1)
    beside = jax.lax.top_k(-far, min(_BESIDE, len(far)))[1]
    some = field(images, near.electrodes[beside])
    rest = (one**2).sum() - (one.reshape(-1, 2)[beside] ** 2).sum()
    taken = _product("ik,jk->ij", some, some) + rest
    return near.feed * plane, near.feed * near.answer * near.radius**2 * taken


def _steep(sheet: Sheet, place: Float[Array, "C 2"], radius: Array) -> Float[Array, "C C 2"]:
    """Computes ∇ at each place of one ampere into each contact, but for a place's images.

    Images of a contact's own patches are among the patches' potentials.
    """
    away = place - _images(sheet, place)[1:]
    square = jnp.maximum((away**2).sum(-1, keepdims=True), radius[:, None] ** 2)
    images = -cast(Near, sheet.near).feed * (away / square).sum(0)
    own = jnp.eye(len(place), dtype=place.dtype)[..., None]
    return slope_of(sheet, place, radius) - own * images


def _shares(
    cloud: _Cloud, given: _Given, sunk: Float[Array, "n S"]
) -> tuple[Float[Array, "S n"], Float[Array, "n n"]]:
    """Solves the patches' equations: shares of the contact's current, and the inverse."""
    unit = jnp.eye(_COUNT, dtype=sunk.dtype)
    inverse = solve_positive(cloud.plane - cloud.taken + given.own * unit, unit)
    base = inverse.sum(1)
    induced = sunk * given.more - _product("nk,sk->ns", cloud.off, given.slope)
    uneven = _balanced(inverse, induced.T)
    shift = _product("sn,nk->sk", uneven, cloud.off)
    length = jnp.sqrt((shift**2).sum(-1, keepdims=True) + 1e-18)
    uneven = uneven * jnp.minimum(1, _FARTHEST * given.radius / length)
    return base / base.sum() + uneven, inverse


def _balanced(
    inverse: Float[Array, "n n"], right: Float[Array, "*k n"]
) -> Float[Array, "*k n"]:
    """Solves the equations with a constant that makes the sum 0."""
    base = inverse.sum(1)
    found = _product("...n,nm->...m", right, inverse)
    return found - found.sum(-1, keepdims=True) * (base / base.sum())


def _moving(
    cloud: _Cloud,
    given: _Given,
    leaving: Float[Array, "n 3 S"],
    shares: Float[Array, "S n"],
    inverse: Float[Array, "n n"],
    along: Float[Array, "2"],
) -> Float[Array, "S 6 M"]:
    """Computes slopes of what patches add, Ω, by place, size, lengths and conductance.

    `along` are a place's own slopes by its parameters, m. Patches move, and as they do, the grounds' potential there. How the potentials between
    patches change is left out.
    """
    unit = jnp.broadcast_to(jnp.diag(along), (_COUNT, 2, 2))
    moves = jnp.concatenate([unit, cloud.moves], 2)  # (n, 2, 5)
    lifted = _product("nks,nkp->spn", leaving[:, 1:], moves) * given.more[:, None, None]
    stronger = (given.own * shares)[:, None]
    turned = _balanced(inverse, jnp.concatenate([lifted, stronger], 1))  # (S, 6, n)
    uneven = shares - 1 / _COUNT
    carried = _product("sn,nkp->spnk", uneven, moves)
    carried = _product("spnk,nkm->spm", carried, cloud.rows[:, 1:])
    carried = jnp.pad(carried, ((0, 0), (0, 1), (0, 0)))
    return carried + _product("spn,nm->spm", turned, cloud.rows[:, 0])


class _Slots(NamedTuple):
    """Contacts in the slots of a frame."""

    sheet: Sheet
    frame: WhitenedFrame
    cloud: _Cloud
    place: Float[Array, "C 2"]
    radius: Float[Array, " C"]
    sunk: Float[Array, "C n S"]

    def agreed(
        self, stronger: Float[Array, " C"], current: Float[Array, "S C"], columns_of
    ) -> tuple[_Given, Float[Array, "S C"]]:
        """Finds conductances that agree with the drops, then `stronger`; and the drops."""
        sheet, frame = self.sheet, self.frame
        level = sheet.slots.level(self.cloud.rows[:, :, 0], frame.grounds)  # (C, n, S)
        among = jax.vmap(green_of(sheet, self.place, self.radius))(self.place)
        steep = _steep(sheet, self.place, self.radius)

        def dropped(current: Array, shares: Array) -> Array:
            # As the current leaves what is even, the contact's mean potential falls.
            uneven, cloud = shares - 1 / _COUNT, self.cloud
            less = _product("csj,cij->cs", uneven, cloud.plane)
            less = less - _product("csj,cij->cs", shares, cloud.taken)
            less = less / _COUNT - _product("csj,cjs->cs", uneven, level)
            means = level.mean(1).T, self.sunk.mean(1).T
            return drops(sheet, frame.grounds, among, *means, current) - current * less.T

        def about(current: Array, drop: Array) -> _Given:
            enough = 1e-4 * jnp.abs(current).sum(1, keepdims=True) + 1e-15
            safe = jnp.where(jnp.abs(current) > enough, current, jnp.inf)
            slope = _product("sd,cdk->sck", current, steep) / safe[..., None]
            forward = jnp.sign(sheet.drive_voltage)
            least = LEAST_DROP * jnp.abs(sheet.drive_voltage)
            through = jnp.maximum(
                (forward * current).mean(0), 1e-6 * least / sheet.sheet_resistance
            )
            own = _COUNT * jnp.maximum((forward * drop).mean(0), least) / through
            whole = current.sum(1, keepdims=True) / safe
            own = own * jnp.exp(-stronger)
            return _Given(own, whole.T, jnp.moveaxis(slope, 1, 0), self.radius)

        def once(_: int, now: tuple[Array, Array]) -> tuple[Array, Array]:
            current, drop = now
            shares, _ = jax.vmap(_shares)(self.cloud, about(current, drop), self.sunk)
            column = whitened_rows(frame, columns_of(shares - 1 / _COUNT))
            current = currents_of(column, frame.whitened)
            return current, dropped(current, shares)

        flat = jnp.full((len(self.place), len(current), _COUNT), 1 / _COUNT, current.dtype)
        now = current, dropped(current, flat)
        now = jax.lax.fori_loop(0, _PASSES, once, jax.lax.stop_gradient(now))
        return jax.lax.stop_gradient((about(*now), now[1]))
