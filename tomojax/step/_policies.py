"""Policies of a step choose the next electrode to ground from the slots so far.

A policy lays out a stretch of ground conditions. After the stretch, the policy is asked
again.
"""

from abc import abstractmethod
from typing import Any, cast, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax._require import require
from tomojax.kernels.contacts import in_slot, slot_weights, whitened
from tomojax.kernels.images import Contacts
from tomojax.kernels.scan import around, Region, smallest_pitch
from tomojax.kernels.sheet import cell_centres
from tomojax.paper import AdaptivePattern, AdaptiveScan, exploration, pattern, PATTERNS
from tomojax.sensor import Sensor

# The paper's: two corner slots, then grounds that depend on them.
ADAPTIVE = ("around", "cop_line", "point")
POLICIES = (*PATTERNS, "around_contacts", "information")

# Places along a side that a table by place is made for.
_PLACES = 32


class Seen(NamedTuple):
    """The facts that a policy may use."""

    explored: Float[Array, "2 M"]  # voltages under the two corner grounds, V
    contacts: Contacts
    doubted: Bool[Array, ""]  # whether they left much of a slot of this stretch unexplained
    ground: Int[Array, ""]  # of the last slot
    conditions: int  # that there are to choose from

    def onwards(self, length: int) -> Int[Array, " L"]:
        """Returns the ground conditions after the last one, in order.

        Grounds next to each other find a further contact: three in a row must show the
        contact at one place. Grounds far from each other find half as many contacts.
        """
        turn = jnp.arange(1, length + 1, dtype=self.ground.dtype)
        return (self.ground + turn) % self.conditions


class Plan(NamedTuple):
    """Ground conditions laid out, and the number of those done."""

    policy: Int[Array, ""]  # which of the step's
    grounds: Int[Array, " M"]
    length: Int[Array, ""]
    at: Int[Array, ""]
    exploring: Bool[Array, ""]  # whether these are the corners
    explored: Float[Array, "2 M"]


class AbstractPolicy(eqx.Module):
    """A policy; `explores` tells whether each stretch begins with the two corner slots."""

    explores: eqx.AbstractClassVar[bool]

    @abstractmethod
    def __call__(self, seen: Seen) -> Int[Array, " L"]:
        """Returns the next L ground conditions, L of 1 to M; compiled."""


class Fixed(AbstractPolicy):
    """A policy that repeats the same ground conditions."""

    explores: ClassVar[bool] = False  # pyright: ignore
    grounds: Int[Array, " L"]

    def __call__(self, seen: Seen) -> Int[Array, " L"]:
        return self.grounds


class Adaptive(AbstractPolicy):
    """The paper's policies: two corner slots, then *Around*, *CoP line* or *Point*."""

    explores: ClassVar[bool] = True  # pyright: ignore
    scan: AdaptiveScan

    def __call__(self, seen: Seen) -> Int[Array, " L"]:
        return self.scan(seen.explored)[0]


class Lookup(AbstractPolicy):
    """A table by place: L ground conditions for each; several contacts take turns.

    Without a contact, `idle` (L,) is grounded. One electrode after another is grounded
    where the contacts do not explain the voltages: a contact may be missing. Designs for
    images have `lam`: the λ of each place, relative to σ₁². A step has its own λ.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> left_and_right = jnp.array([[[0, 3]], [[12, 15]]])  # grounds of 2 × 1 places
    >>> policy = tx.step.Lookup(left_and_right, jnp.array([0, 15]), sensor.size)
    >>> step = tx.make_step(
    ...     sensor, "source", "mine", tables={"mine": policy}, contacts=1, grid=8
    ... )
    >>> volts = tx.voltages(sensor, tx.Disc([0.07, 0.05], 0.006, 1.0), [0, 15])
    >>> state, out = step(step.state, volts[0], 0)
    >>> state, out = step(state, volts[1], int(out.ground))
    >>> int(out.ground)  # of the right
    12
    """

    explores: ClassVar[bool] = False  # pyright: ignore
    table: Int[Array, "nx ny L"]
    idle: Int[Array, " L"]
    size: Float[Array, "2"]
    lam: Float[Array, "nx ny"] | None = None

    def __call__(self, seen: Seen) -> Int[Array, " L"]:
        contacts = seen.contacts
        cells = jnp.asarray(self.table.shape[:2], self.size.dtype)
        at = jnp.nan_to_num(contacts.xy) / self.size * cells
        index = jnp.clip(at, 0, cells - 1).astype(int)
        each = self.table[index[:, 0], index[:, 1]]  # (C, L)
        length, count = each.shape[1], contacts.count.astype(int)
        turn = jnp.arange(length)
        some = jnp.maximum(count, 1)
        # With n contacts each is given every nth of its own.
        mixed = each[turn % some, turn]
        onwards = seen.onwards(length).astype(mixed.dtype)
        grounds = jnp.where(seen.doubted, onwards, mixed)
        return jnp.where(count > 0, grounds, self.idle)


class Information(AbstractPolicy):
    """One slot at a time: the ground whose slot should say most of the contacts' places.

    The ground l has the largest Σ_c ln|I + P_c·J_c(l)|. P is the covariance of a contact's
    place; J(l) is a slot's information on the place, looked up by place. The next electrode
    is grounded where the contacts do not explain the voltages, as by `Lookup`.
    """

    explores: ClassVar[bool] = False  # pyright: ignore
    places: Float[Array, "K 2"]
    information: Float[Array, "K L 3"]  # of a place: xx, yy, xy, 1/m²
    idle: Int[Array, ""]  # grounded while there is no contact

    def __call__(self, seen: Seen) -> Int[Array, " L"]:
        contacts = seen.contacts
        there = jnp.arange(len(contacts.xy)) < contacts.count.astype(int)
        xy = jnp.nan_to_num(contacts.xy)
        away = ((self.places - xy[:, None]) ** 2).sum(-1)
        a, b, c = jnp.moveaxis(self.information[jnp.argmin(away, 1)], -1, 0)  # (C, M)
        unit = jnp.ones_like(contacts.covariance).at[:, 2].set(0) * 1e-6
        spread = jnp.where(jnp.isfinite(contacts.covariance), contacts.covariance, unit)
        xx, yy, mixed = (s[:, None] for s in spread.T)
        # |I + PJ| = 1 + tr PJ + |P||J|: the little that a slot adds keeps its digits.
        both = (xx * yy - mixed**2) * (a * b - c**2)
        told = jnp.log1p(xx * a + yy * b + 2 * mixed * c + jnp.maximum(both, 0))
        gain = jnp.where(there[:, None], told, 0).sum(0)
        # Again the same says little that is new: its errors are the same.
        again = jnp.arange(len(gain), dtype=seen.ground.dtype) == seen.ground
        best = jnp.argmax(jnp.where(again, -jnp.inf, gain))
        best = jnp.where(seen.doubted, seen.onwards(1)[0].astype(best.dtype), best)
        return jnp.where(there.any(), best, self.idle)[None]


def policy_name(policy: Any) -> str:
    """Names a policy; grounds of one's own are named by their numbers: "0,7,14".

    **Raises:** `ValueError` for what is neither a name nor whole numbers.
    """
    if isinstance(policy, str):
        return policy
    expected = "a name, or electrodes in order: [0, 7, 14]"
    try:
        grounds = np.asarray(policy)
    except ValueError:  # lists of unlike lengths
        grounds = np.zeros(0)
    whole = grounds.ndim == 1 and grounds.size > 0 and grounds.dtype.kind in "iu"
    require(whole, "policy", repr(policy), expected)
    return ",".join(map(str, grounds.tolist()))


def policy_names(policy: Any) -> list[str]:
    """Names each of one or several policies; whole numbers in a row are one policy."""
    if isinstance(policy, str):
        return [policy]
    each = list(policy)
    numbers = bool(each) and all(np.ndim(p) == 0 and not isinstance(p, str) for p in each)
    return [policy_name(policy)] if numbers else [policy_name(p) for p in each]


def policy(sensor: Sensor, name: str, follow: Any) -> AbstractPolicy:
    """Makes the policy of that name: a pattern's, "around_contacts" or "information".

    A name of numbers, "0,7,14", grounds these electrodes over and over. `follow`, of the
    sensor, gives "information" its tables; other policies do not use `follow`.
    """
    if name and set(name) <= set("0123456789,- "):
        return Fixed(_grounds(name, sensor.condition_count))
    expected = f"electrodes with commas, or one of {', '.join(POLICIES)}"
    require(name in POLICIES, "policy", repr(name), expected)
    if name in ADAPTIVE:
        return Adaptive(AdaptiveScan(sensor, cast(AdaptivePattern, name)))
    if name == "around_contacts":
        table = around_table(sensor)
        idle = jnp.resize(exploration(sensor), table.shape[-1:])
        return Lookup(table, idle, sensor.size)
    if name == "information":
        told = _information(follow, sensor.condition_count)
        return Information(follow.candidates.place, told, exploration(sensor)[0])
    return Fixed(pattern(sensor, name))


def _grounds(name: str, electrodes: int) -> Int[Array, " L"]:
    """Reads the electrodes of a policy that is named by them."""
    try:
        grounds = np.array([int(part) for part in name.split(",")])
    except ValueError:
        grounds = np.array([-1])
    last = electrodes - 1
    inside = bool((grounds >= 0).all() and (grounds <= last).all())
    require(inside, "policy", repr(name), f"electrodes from 0 to {last} with commas")
    few = len(grounds) <= electrodes
    require(few, "policy", f"{len(grounds)} grounds", f"{electrodes} or fewer")
    return jnp.asarray(grounds, jnp.int32)


def around_table(sensor: Sensor) -> Int[Array, "nx ny L"]:
    """Makes a table by place: *Around*'s grounds for a small contact."""
    grid = cell_centres((_PLACES, _PLACES))
    places = jnp.asarray(grid * np.asarray(sensor.size), sensor.dtype)

    def one(place: Array, xy: Array) -> Array:
        zero, direction = jnp.zeros((), int), jnp.zeros((), place.dtype)
        inside = jnp.zeros(len(xy), bool)
        region = Region(zero, inside, place, place, direction, zero, zero)
        return around(region, xy, smallest_pitch(sensor.electrode_xy))

    def every(places: Array, xy: Array) -> Array:
        return jax.vmap(one, (0, None))(places, xy).reshape(_PLACES, _PLACES, -1)

    return jax.jit(every)(places, sensor.ground_xy())


def _information(follow: Any, conditions: int) -> Float[Array, "K L 3"]:
    """Computes each ground condition's information on a usual contact's place, 1/m²."""
    sheet, noise = follow.points.sheet, follow.errors
    tangent, unit = follow.candidates.tangent, sheet.unit
    # A current that makes a tenth of the drive, so that noise is the lesser part.
    current = 0.1 * sheet.drive_voltage / sheet.sheet_resistance

    def one(raw: Float[Array, "4 M"], ground: Array) -> Float[Array, "3"]:
        columns = current * in_slot(sheet, raw[None], ground)[0]
        weights = slot_weights(noise, columns[0], jnp.ones(len(columns[0]), bool))
        base, *others = whitened(weights, columns[:3])
        # What no current explains of a move.
        rest = jnp.stack([x - base * ((x @ base) / (base @ base)) for x in others])
        normal = rest @ rest.T / unit**2
        return jnp.stack([normal[0, 0], normal[1, 1], normal[0, 1]])

    grounds = jnp.arange(conditions)
    every = jax.vmap(jax.vmap(one, (None, 0)), (0, None))
    return jax.jit(every)(tangent, grounds)
