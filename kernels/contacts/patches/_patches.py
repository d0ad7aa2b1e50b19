"""Models contacts about as long as wide by patches, whose currents the sheet decides.

`discs` spreads a contact's current evenly, and leans it to one side. Under metal that lies
on an electrode in part the current goes elsewhere: to the electrode's rim, and round it.
Here a contact is a cloud of patches of one conductance each. The patches' shares of the
current solve the sheet's own equations, slot by slot.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
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
from tomojax.kernels.contacts._points import (
    DISC,
    drops,
    Fitted,
    green_of,
    kept_within,
    LEAST_DROP,
    LONG,
    Sheet,
    unpack,
)
from tomojax.kernels.contacts.patches._cloud import (
    Cloud,
    cloud_of,
    COUNT,
    product,
    steep_of,
)

# How well a slot's level is known, 1 σ, of the drive. The level tells a contact's drop and
# so its conductance; of metal, whose drop is small, the current's shape tells more.
_LEVEL = 0.05


class _Given(NamedTuple):
    """Values that one contact's shares depend on, beside its own place and shape."""

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
    cloud = jax.vmap(cloud_of, (None, 0, 0, 0))(sheet, place, radius, parameters)
    slots, offset = sheet.slots, sheet.slots.offset(frame.grounds)[:, None]

    def columns_of(uneven: Float[Array, "C S n"]) -> Float[Array, "S C M"]:
        rows = product("csn,cnm->scm", uneven, cloud.rows[:, :, 0]) + table[:, 0]
        return slots.apart(rows, frame.grounds) + offset

    count, kinds = len(place), len(frame.grounds)
    even = columns_of(jnp.zeros((count, kinds, COUNT), place.dtype))
    current = currents_of(whitened_rows(frame, even), frame.whitened)
    leaving = slots.sunk(cloud.rows, frame.grounds, made_by(current, even))  # (C, n, 3, S)
    about = _Contacts(sheet, frame, cloud, place, radius, leaving[:, :, 0])
    given, drop = about.agreed(parameters[:, 5], current, columns_of)
    shares, inverse = jax.vmap(_shares)(cloud, given, leaving[:, :, 0])
    columns = columns_of(shares - 1 / COUNT)
    column = whitened_rows(frame, columns)
    current, rest = best_currents(column, frame.whitened)
    chain = chain_of(sheet, parameters, radius)[:, : DISC - 1]
    moving = jax.vmap(_moving)(cloud, given, leaving, shares, inverse, chain[:, :2])
    by_table = jnp.pad(table[:, 1:DISC] * chain[..., None], ((0, 0), (0, 1), (0, 0)))
    slopes = jnp.moveaxis(by_table[:, None] + moving, 1, 0)
    tangent = slots.apart(slopes, frame.grounds) * current[..., None, None]
    tangent = whitened_rows(frame, tangent.reshape(kinds, count * DISC, -1))
    prior, by_parameter = priors_of(parameters, about.told(drop))
    none = jnp.zeros_like(place)
    at = jax.vmap(home_of, (None, 0))(sheet.field, place)
    volts = made_by(current, columns)
    fitted = Fitted(at, none, none[:, 0], radius, current, drop, volts)
    return Explained(rest, column, tangent, prior, by_parameter, fitted)


def _shares(
    cloud: Cloud, given: _Given, sunk: Float[Array, "n S"]
) -> tuple[Float[Array, "S n"], Float[Array, "n n"]]:
    """Solves the patches' equations: shares of the contact's current, and the inverse."""
    unit = jnp.eye(COUNT, dtype=sunk.dtype)
    inverse = solve_positive(cloud.plane - cloud.taken + given.own * unit, unit)
    base = inverse.sum(1)
    induced = sunk * given.more - product("nk,sk->ns", cloud.off, given.slope)
    uneven = _balanced(inverse, induced.T)
    shift = product("sn,nk->sk", uneven, cloud.off)
    uneven = uneven * kept_within(shift, given.radius)
    return base / base.sum() + uneven, inverse


def _balanced(
    inverse: Float[Array, "n n"], right: Float[Array, "*k n"]
) -> Float[Array, "*k n"]:
    """Solves the equations with a constant that makes the sum 0."""
    base = inverse.sum(1)
    found = product("...n,nm->...m", right, inverse)
    return found - found.sum(-1, keepdims=True) * (base / base.sum())


def _moving(
    cloud: Cloud,
    given: _Given,
    leaving: Float[Array, "n 3 S"],
    shares: Float[Array, "S n"],
    inverse: Float[Array, "n n"],
    along: Float[Array, "2"],
) -> Float[Array, "S 6 M"]:
    """Computes slopes of what patches add, Ω, by place, size, lengths and conductance.

    Patches move, and the grounds' potential there changes. How the potentials between
    patches change is left out. `along` are a place's own slopes by its parameters, m.
    """
    unit = jnp.broadcast_to(jnp.diag(along), (COUNT, 2, 2))
    moves = jnp.concatenate([unit, cloud.moves], 2)  # (n, 2, 5)
    lifted = product("nks,nkp->spn", leaving[:, 1:], moves) * given.more[:, None, None]
    stronger = (given.own * shares)[:, None]
    turned = _balanced(inverse, jnp.concatenate([lifted, stronger], 1))  # (S, 6, n)
    uneven = shares - 1 / COUNT
    carried = product("sn,nkp->spnk", uneven, moves)
    carried = product("spnk,nkm->spm", carried, cloud.rows[:, 1:])
    carried = jnp.pad(carried, ((0, 0), (0, 1), (0, 0)))
    return carried + product("spn,nm->spm", turned, cloud.rows[:, 0])


class _Contacts(NamedTuple):
    """Contacts in the slots of a frame."""

    sheet: Sheet
    frame: WhitenedFrame
    cloud: Cloud
    place: Float[Array, "C 2"]
    radius: Float[Array, " C"]
    sunk: Float[Array, "C n S"]  # the grounds' potential at the patches, Ω

    def agreed(
        self,
        stronger: Float[Array, " C"],
        current: Float[Array, "S C"],
        columns_of: Callable[[Array], Array],
    ) -> tuple[_Given, Float[Array, "S C"]]:
        """Finds what shares depend on, and drops that agree with the shares, V.

        `stronger`: ln of a conductance beside what the drop tells.
        """
        among = jax.vmap(green_of(self.sheet, self.place, self.radius))(self.place)
        steep = steep_of(self.sheet, self.place, self.radius)
        flat = jnp.full((len(self.place), len(current), COUNT), 1 / COUNT, current.dtype)

        drop = self._dropped(among, current, flat)
        given = self._given(steep, stronger, current, drop)
        # Once more, with the current's shape: a third time changes no place.
        shares, _ = jax.vmap(_shares)(self.cloud, given, self.sunk)
        column = whitened_rows(self.frame, columns_of(shares - 1 / COUNT))
        current = currents_of(column, self.frame.whitened)
        drop = self._dropped(among, current, shares)
        return self._given(steep, stronger, current, drop), drop

    def told(self, drop: Float[Array, "S C"]) -> Float[Array, " C"]:
        """Returns 1/σ of ln g as drops tell it."""
        least = LEAST_DROP * jnp.abs(self.sheet.drive_voltage)
        of_level = _LEVEL * jnp.abs(self.sheet.drive_voltage)
        return jnp.maximum(self._forward(drop), least) / of_level

    def _forward(self, values: Float[Array, "S C"]) -> Float[Array, " C"]:
        return (jnp.sign(self.sheet.drive_voltage) * values).mean(0)

    def _given(self, steep: Array, stronger: Array, current: Array, drop: Array) -> _Given:
        enough = 1e-4 * jnp.abs(current).sum(1, keepdims=True) + 1e-15
        safe = jnp.where(jnp.abs(current) > enough, current, jnp.inf)
        slope = product("sd,cdk->sck", current, steep) / safe[..., None]
        least = LEAST_DROP * jnp.abs(self.sheet.drive_voltage)
        through = 1e-6 * least / self.sheet.sheet_resistance
        through = jnp.maximum(self._forward(current), through)
        own = COUNT * jnp.maximum(self._forward(drop), least) / through
        more = current.sum(1, keepdims=True) / safe
        own = own * jnp.exp(-stronger)
        return _Given(own, more.T, jnp.moveaxis(slope, 1, 0), self.radius)

    def _dropped(self, among: Array, current: Array, shares: Array) -> Float[Array, "S C"]:
        """Computes V0 − u: as a current leaves what is even, the mean potential falls."""
        slots, uneven, cloud = self.sheet.slots, shares - 1 / COUNT, self.cloud
        level = slots.level(cloud.rows[:, :, 0], self.frame.grounds)  # (C, n, S)
        less = product("csj,cij->cs", uneven, cloud.plane)
        less = less - product("csj,cij->cs", shares, cloud.taken)
        less = less / COUNT - product("csj,cjs->cs", uneven, level)
        means = level.mean(1).T, self.sunk.mean(1).T
        drop = drops(self.sheet, self.frame.grounds, among, *means, current)
        return drop - current * less.T
