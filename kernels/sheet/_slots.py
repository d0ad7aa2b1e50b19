"""The law of slots: volts per ampere under a ground condition, T, and the family J(ρ).

An ampere enters the sheet where its potentials at the electrodes are r. With r̃ = [r; 1] the
electrodes are then at V = D·r̃, and the current's own place x is at G(x, x) + r̃ᵀS r̃ (Ω). A
condition is a pair (D, S). `Grounds` has it in closed form where one electrode is grounded.
`Conditions` has it for any conductances to ground. Both have the same members, and take
arrays of NumPy and of JAX.

All follows by arithmetic from the table of transfer resistances.
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int


class Resistances(NamedTuple):
    """Transfer resistances of a sheet, Ω, for M electrodes and K elements.

    R is a symmetric inverse of the sheet's stiffness on balanced currents; p_e reads and
    feeds electrode e, b_k element k. Only differences that balance are physical. Adding c_e
    + c_f to `electrodes`, c_e + d_k to `elements` and 2·d_k to `own` changes no voltage.
    `centred` makes the choice unique.
    """

    electrodes: Float[Array, "M M"]  # R_ee' = p_eᵀ R p_e'
    elements: Float[Array, "M K"]  # R_ek = p_eᵀ R b_k
    own: Float[Array, " K"]  # R_kk = b_kᵀ R b_k


def centred(table: Resistances) -> Resistances:
    """Shifts the table so that the mean potential of the electrodes is zero.

    R ← (I − 1mᵀ) R (I − m1ᵀ), m the mean over the electrodes. The values are then small,
    which float32 needs, and do not depend on the route that made them.
    """
    ee, ek, kk = table
    row, column = ee.mean(0), ek.mean(0)
    mean = row.mean()
    return Resistances(
        ee - row[:, None] - row[None, :] + mean,
        ek - row[:, None] - column[None, :] + mean,
        kk - 2 * column + mean,
    )


A = TypeVar("A", Array, np.ndarray)

# An electrode that its ground leaves this part of its potential tells of the path to ground
# alone, which is hardly known.
_SHORT = 0.01


class Grounds(NamedTuple):
    """One grounded electrode l a slot: V_i = r_i − r_l + (R_ll + z − R_il), per ampere.

    `which` of the members is l.
    """

    electrodes: Any  # R_ee' (M, M), Ω
    resistance: Any  # z, Ω: one value or one for each electrode

    def path(self, which: Int[A, "*L"]) -> Float[A, "*L"]:
        """Computes R_ll + z, Ω."""
        z = self.resistance
        each = z[which] if np.ndim(z) else z
        return self.electrodes[which, which] + each

    def offset(self, which: Int[A, "*L"]) -> Float[A, "*L M"]:
        """Computes R_ll + z − R_il, Ω: all but what depends on where the current enters."""
        return self.path(which)[..., None] - self.electrodes[which]

    def relative(self, rows: Float[A, "*n M"], which: Int[A, "*L"]) -> Float[A, "... M"]:
        """Computes r_i − r_l: what depends on where the current enters."""
        return rows[(..., *(None,) * which.ndim, slice(None))] - rows[..., which][..., None]

    def apart(self, rows: Float[A, "L *n M"], which: Int[A, " L"]) -> Float[A, "L *n M"]:
        """Computes `relative` of rows of each slot's own."""
        at = jnp.take_along_axis(rows, which[(slice(None), *(None,) * (rows.ndim - 1))], -1)
        return rows - at

    def level(self, rows: Float[A, "*n M"], which: Int[A, "*L"]) -> Float[A, "..."]:
        """Computes r_l: the sheet's level is `path` less this, for each ampere."""
        return rows[..., which]

    def sunk(
        self, rows: Float[A, "*n M"], which: Int[A, "*L"], volts: Float[A, "*L M"]
    ) -> Float[A, "..."]:
        """Computes r_e, averaged over where the current leaves: r_l.

        `volts` are the slots' own.
        """
        return rows[..., which]

    def maps(self, elements: Float[A, "M K"], which: Int[A, " L"]) -> Float[A, "L M K"]:
        """Computes T^l_ik = R_ik − R_lk − R_il + R_ll + z (Ω): a slot's V = T^l s.

        s (A per element) is the current that the object feeds into the sheet.
        """
        apart = elements[None] - elements[which][:, None]
        return apart + self.offset(which)[:, :, None]

    def loops(
        self, table: Resistances, which: Int[A, " L"], maps: Float[A, "L M K"]
    ) -> Float[A, "L K"]:
        """Computes R_kk + R_ll − 2R_lk + z (Ω): from element k through the sheet to l."""
        return table.own + self.path(which)[:, None] - 2 * table.elements[which]

    def grounded(self, which: Int[A, "*L"]) -> Bool[A, "*L M"]:
        """Tells the electrodes whose voltage tells of their path to ground: l."""
        xp: Any = np if isinstance(which, np.ndarray) else jnp
        return xp.arange(len(self.electrodes), dtype=which.dtype) == which[..., None]


class Conditions(NamedTuple):
    """Conductances γ_e to ground at any electrodes: (D, S) of each of L conditions.

    With Γ = diag γ and x = (I + RΓ)⁻¹1: D = [(I − xγᵀ/γᵀx)(I + RΓ)⁻¹ | x/γᵀx]. The first
    block is I − UE, E the rows of I of the g electrodes with a path to ground. The sheet's
    level per ampere is 1/γᵀx − (Γx)ᵀr/γᵀx, and γ_e V_e leaves at electrode e. `which` of
    the members is a condition's number.
    """

    at: Any  # the electrodes of E (L, g)
    taken: Any  # U (L, M, g)
    offsets: Any  # D's last column (L, M), Ω
    to_ground: Any  # γ (L, M), S
    levels: Any  # Γx/γᵀx (L, M)
    paths: Any  # 1/γᵀx (L,), Ω

    def path(self, which: Int[A, "*L"]) -> Float[A, "*L"]:
        return self.paths[which]

    def offset(self, which: Int[A, "*L"]) -> Float[A, "*L M"]:
        return self.offsets[which]

    def block(self, which: Int[A, "*L"]) -> Float[A, "*L M M"]:
        """Returns D's first block."""
        m, at = self.taken.shape[1], self.at[which]
        row = (at[..., None] == np.arange(m, dtype=at.dtype)).astype(self.taken.dtype)
        return np.eye(m, dtype=row.dtype) - _product(
            "...mg,...gn->...mn", self.taken[which], row
        )

    def relative(self, rows: Float[A, "*n M"], which: Int[A, "*L"]) -> Float[A, "... M"]:
        m, g = self.taken.shape[1:]
        flat, at = rows.reshape(-1, m), self.at[which].reshape(-1, g)
        taken = self.taken[which].reshape(-1, m, g)
        flat = flat[:, None] - _product("nlg,lmg->nlm", flat[:, at], taken)
        return flat.reshape(*rows.shape[:-1], *which.shape, m)

    def apart(self, rows: Float[A, "L *n M"], which: Int[A, " L"]) -> Float[A, "L *n M"]:
        flat = rows.reshape(len(rows), -1, rows.shape[-1])
        at = jnp.take_along_axis(flat, self.at[which][:, None], -1)
        return (flat - _product("lng,lmg->lnm", at, self.taken[which])).reshape(rows.shape)

    def level(self, rows: Float[A, "*n M"], which: Int[A, "*L"]) -> Float[A, "..."]:
        return _along(rows, self.levels[which])

    def sunk(
        self, rows: Float[A, "*n M"], which: Int[A, "*L"], volts: Float[A, "*L M"]
    ) -> Float[A, "..."]:
        leaves = self.to_ground[which] * volts
        total = leaves.sum(-1, keepdims=True)
        return _along(rows, leaves / jnp.where(total == 0, 1, total))

    def maps(self, elements: Float[A, "M K"], which: Int[A, " L"]) -> Float[A, "L M K"]:
        there = _product("lmg,lgk->lmk", self.taken[which], elements[self.at[which]])
        return elements - there + self.offsets[which][:, :, None]

    def loops(
        self, table: Resistances, which: Int[A, " L"], maps: Float[A, "L M K"]
    ) -> Float[A, "L K"]:
        leaves = self.to_ground[which][:, :, None] * maps
        back = _product("mk,lmk->lk", table.elements, leaves)
        level = self.paths[which][:, None] - self.levels[which] @ table.elements
        return table.own - back + level

    def grounded(self, which: Int[A, "*L"]) -> Bool[A, "*L M"]:
        left = jnp.abs(self.block(which)).max(-1)
        return (self.to_ground[which] > 0) & (left < _SHORT)


Slots = Grounds | Conditions


def conditions_of(
    electrodes: Float[A, "M M"], to_ground: Float[A, "L M"], at: Int[A, "L g"] | None = None
) -> Conditions:
    """Computes (D, S) of conductances to ground (S), from R_ee' (Ω).

    At least one γ of a condition must be positive; otherwise the result is infinite. `at`
    has the electrodes that may have a path to ground; found where γ is known.
    """
    xp: Any = np if isinstance(electrodes, np.ndarray) else jnp
    unit = xp.eye(len(electrodes), dtype=electrodes.dtype)
    system = unit + electrodes * to_ground[:, None, :]
    inverse = xp.linalg.inv(system)
    x = inverse.sum(-1)
    leaves = to_ground * x
    total = leaves.sum(-1, keepdims=True)
    lost = _product("lm,lmn->ln", to_ground, inverse) / total
    at = xp.asarray(_grounded(to_ground)) if at is None else at
    taken = unit - inverse + x[:, :, None] * lost[:, None, :]
    taken = xp.take_along_axis(taken, at[:, None], -1)
    return Conditions(at, taken, x / total, to_ground, leaves / total, 1 / total[:, 0])


def _grounded(to_ground: Float[A, "L M"]) -> np.ndarray:
    """Returns each condition's electrodes with a path to ground, as many of each."""
    if isinstance(to_ground, jax.core.Tracer):
        shape = to_ground.shape
        return np.broadcast_to(np.arange(shape[1], dtype=np.int32), shape)
    there = np.asarray(to_ground) > 0
    most = max(1, there.sum(1).max())
    return np.argsort(~there, 1, kind="stable")[:, :most].astype(np.int32)


def lengthened(slots: Slots, electrodes: Any, more: Any) -> Slots:
    """Adds resistances (Ω) to the electrodes' paths to ground."""
    if isinstance(slots, Grounds):
        return slots._replace(resistance=slots.resistance + more)
    to_ground = slots.to_ground / (1 + slots.to_ground * more)
    return conditions_of(electrodes, to_ground, slots.at)


def volts_per_ampere(
    slots: Slots,
    potential: Float[A, "*batch M"],
    which: Int[A, " L"],
) -> Float[A, "*batch L M"]:
    """Computes D·[r; 1], Ω."""
    return slots.relative(potential, which) + slots.offset(which)


def slot_jacobian(
    table: Resistances,
    slots: Slots,
    which: Int[Array, " L"],
    contact_resistance: Float[Array, "..."],
) -> Float[Array, "L M K"]:
    """Computes `contact_jacobian` of slots."""
    maps = slots.maps(table.elements, which)
    return contact_jacobian(maps, slots.loops(table, which, maps), contact_resistance)


def _along(rows: Any, weights: Any) -> Any:
    """Sums rows (*n, M), weighed (*L, M): (*n, *L)."""
    flat = _product("nm,lm->nl", *(a.reshape(-1, a.shape[-1]) for a in (rows, weights)))
    return flat.reshape(*rows.shape[:-1], *weights.shape[:-1])


def _product(how: str, one: Any, other: Any) -> Any:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.einsum(how, one, other, optimize=True)
    return jnp.einsum(how, one, other, precision="highest")


def contact_jacobian(
    t: Float[Array, "L M K"],
    loop: Float[Array, "L K"],
    contact_resistance: Float[Array, "..."],
) -> Float[Array, "L M K"]:
    """Computes J^l_ik(ρ) = T^l_ik / (ρ + loop^l_k): V per volt of one element in contact.

    ρ (Ω) is one number, or one per element. The paper's Eq. 1 has ρ = 0 (a potential
    imposed at element k). ρ·J → T for ρ → ∞ is a fixed current. If ρ = z = 0, numerator and
    denominator both vanish where an element coincides with the grounded electrode. The
    ground wins there and J is 0, since nothing but a short is left to see. The test is at
    rounding level, eps·(largest loop of the slot).
    """
    total = contact_resistance + loop
    largest = jnp.max(jnp.abs(loop), axis=-1, keepdims=True)
    shorted = total <= 16 * jnp.finfo(loop.dtype).eps * largest
    conductance = jnp.where(shorted, 0, 1 / jnp.where(shorted, 1, total))
    return t * conductance[:, None, :]
