"""Reduces a sheet in contact to its electrodes: exact for any contact and ground.

Pin the sheet's reference at one place. Let j be the currents that the electrodes draw, and
D the object's potential above the reference. For a contact g

    v = V0·1 − f·D − Q·j,   p·D = fᵀj,   u_k = V0 − c_k·D − X_k·j

So M voltages can tell only p, f and Q of a contact; a ground only says how j follows from
v. No term cancels when the contact is weak or strong. A contact has sites k: nodes of a
mesh, elements, or electrodes.

`reduce_sites` takes many sites of which few matter to each other. A site is a part of the
sheet that current enters in fixed shares (a pixel, say), or an electrode's metal. R between
all sites is computed once for a sheet. A contact then needs one factor of its strong sites.
Weak sites also take from each other's current, to second order in how weak they are.
Voltages leave this effect out. Fields, which give the slopes, are those of the strong sites
alone.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.sheet._slots import Grounds, Slots


class ContactReduction(NamedTuple):
    """The reduced sheet: `fem_contact` (nodes) and `reduce_sites` (pixels) make one."""

    conductance: Float[Array, ""]  # p: object to reference, S
    lift: Float[Array, " M"]  # b: electrodes, object at 1 V, reference at 0 V
    shortfall: Float[Array, " M"]  # f = 1 − b, computed apart
    resistance: Float[Array, "M M"]  # Q: object and reference at 0 V, Ω
    field: Float[Array, "sites M"]  # X: the same, from electrodes to sites, Ω
    gap: Float[Array, " sites"]  # c: sites, reference at 1 V, object at 0 V


def touch_electrodes(
    contact: ContactReduction, direct: Float[Array, " M"]
) -> ContactReduction:
    """Adds `direct` conductances C (S) from the object to electrodes to the contact.

    N = I + QC: f' = N⁻¹f, Q' = N⁻¹Q, b' = b + QCf', p' = p + fᵀCf'. The electrodes join the
    sites at the end, with their own potentials.
    """
    q, f = contact.resistance, contact.shortfall
    m = len(q)
    system = jnp.eye(m, dtype=q.dtype) + q * direct
    solution = jnp.linalg.solve(system, jnp.concatenate([q, f[:, None]], 1))
    new_q, new_f = solution[:, :m], solution[:, m]
    passed = jnp.eye(m, dtype=q.dtype) - direct[:, None] * new_q
    return ContactReduction(
        contact.conductance + jnp.vdot(f * direct, new_f, precision="highest"),
        contact.lift + matmul(q, direct * new_f),
        new_f,
        new_q,
        jnp.concatenate([matmul(contact.field, passed), new_q]),
        jnp.concatenate([contact.gap - matmul(contact.field, direct * new_f), new_f]),
    )


class _Ground(NamedTuple):
    q: Float[Array, "L M"]  # Q_il
    total: Float[Array, " L"]  # z + Q_ll
    f: Float[Array, " L"]  # f_l
    b: Float[Array, " L"]  # b_l
    denominator: Float[Array, " L"]  # p(z + Q_ll) + f_l²


def _ground(contact: ContactReduction, slots: Grounds, which: Array) -> _Ground:
    q, f = contact.resistance[which], contact.shortfall[which]
    total = Grounds(contact.resistance, slots.resistance).path(which)
    return _Ground(q, total, f, contact.lift[which], contact.conductance * total + f**2)


class _Shared(NamedTuple):
    """What conductances γ to ground make of a contact: j = Γv at 1 V of the object.

    (I + QΓ)v = b + f·E, with E = 1 − D = (p − fᵀΓy)/(p + fᵀΓx), (I + QΓ)x = f and
    (I + QΓ)y = b. An ampere into electrode i, the object at 0 V, makes w_i = (I + QΓ)⁻¹Qe_i
    and x·(f_i − fᵀΓw_i)/(p + fᵀΓx).
    """

    volts: Float[Array, "L M"]
    above: Float[Array, " L"]  # D, computed apart
    conductance: Float[Array, "L M"]  # γ, S
    fed: Float[Array, "L M M"]  # (slot, electrode, fed electrode), Ω
    level: Float[Array, "L M"]  # E for each fed electrode, Ω


def _shared(contact: ContactReduction, to_ground: Float[Array, "L M"]) -> _Shared:
    """Without contact or ground the sheet floats, and 0 V is returned."""
    q, f, p = contact.resistance, contact.shortfall, contact.conductance
    unit = jnp.eye(len(q), dtype=q.dtype)

    def one(gamma: Float[Array, " M"]) -> tuple:
        right = jnp.concatenate([jnp.stack([f, contact.lift], 1), q], 1)
        solution = jnp.linalg.solve(unit + q * gamma, right)
        x, y, w = solution[:, 0], solution[:, 1], solution[:, 2:]
        by_x, by_y, *by_w = matmul(f * gamma, solution)
        denominator = p + by_x
        floating = denominator == 0
        over = jnp.where(floating, 0, 1 / jnp.where(floating, 1, denominator))
        level = (f - jnp.stack(by_w)) * over
        volts = jnp.where(floating, 0, x * (p - by_y) * over + y)
        return volts, (by_x + by_y) * over, w + x[:, None] * level, level

    volts, above, fed, level = jax.vmap(one)(to_ground)
    return _Shared(volts, above, to_ground, fed, level)


def ground_voltages(
    contact: ContactReduction,
    slots: Slots,
    which: Int[Array, " L"],
    drive_voltage: Float[Array, ""],
) -> Float[Array, "L M"]:
    """Computes all M voltages (V) under each ground condition.

    With one electrode grounded V_i^l = V0·[p(z + Q_ll − Q_il) + f_l(b_i − b_l)] /
    [p(z + Q_ll) + f_l²].
    """
    if not isinstance(slots, Grounds):
        return drive_voltage * _shared(contact, slots.to_ground[which]).volts
    g = _ground(contact, slots, which)
    through = contact.conductance * (g.total[:, None] - g.q)
    around = g.f[:, None] * (contact.lift[None, :] - g.b[:, None])
    return drive_voltage * (through + around) / g.denominator[:, None]


def voltage_drop(
    contact: ContactReduction,
    slots: Slots,
    which: Int[Array, " L"],
    drive_voltage: Float[Array, ""],
) -> Float[Array, "L sites"]:
    """Computes V0 − u_k^l (V), which drives the current s_k = g_k(V0 − u_k) into a site."""
    if not isinstance(slots, Grounds):
        s = _shared(contact, slots.to_ground[which])
        leaves = matmul(s.conductance * s.volts, contact.field.T)
        return drive_voltage * (s.above[:, None] * contact.gap + leaves)
    g = _ground(contact, slots, which)
    drop = g.f[:, None] * contact.gap + contact.conductance * contact.field.T[which]
    return drive_voltage * drop / g.denominator[:, None]


def voltage_slopes(
    contact: ContactReduction,
    slots: Slots,
    which: Int[Array, " L"],
    drive_voltage: Float[Array, ""],
) -> Callable[[Float[Array, "some P"], Int[Array, " some"]], Float[Array, "L M P"]]:
    """Makes a map from ∂g/∂(P parameters) at some sites to ∂V_i^l/∂(parameters), V.

    The map takes ∂g and the sites' numbers. The adjoint derivative is ∂V_i^l/∂g_k =
    ψ_i^l(k)·(V0 − u_k^l), V/S. Here ψ_i^l is the potential of a unit current into electrode
    i, with the ground l and the object at 0 V. Its value at k is X_ki − Σ_e γ_e v_e·X_ke +
    c_k·E, of v and E that the unit current makes. With one electrode grounded this is X_ki
    − t_il·X_kl + c_k·[f_i(z + Q_ll) − f_l·Q_il]/d_l, with t_il = (p·Q_il + f_i·f_l)/d_l and
    d_l = p(z + Q_ll) + f_l². At g = 0 ψ is T. The slopes are products of L + M fields: one
    product of matrices serves all parameters.
    """
    fields = jnp.concatenate([contact.field, contact.gap[:, None]], 1)
    drop = voltage_drop(contact, slots, which, drive_voltage)
    if isinstance(slots, Grounds):
        g = _ground(contact, slots, which)
        f, over = contact.shortfall, 1 / g.denominator[:, None]
        share = (contact.conductance * g.q + f * g.f[:, None]) * over
        lift = (f * g.total[:, None] - g.f[:, None] * g.q) * over

        def leaves(at: Float[Array, "L M P"]) -> Float[Array, "L M P"]:
            return share[:, :, None] * jnp.take_along_axis(at, which[:, None, None], 1)
    else:
        s = _shared(contact, slots.to_ground[which])
        lift, out = s.level, s.conductance[:, :, None] * s.fed

        def leaves(at: Float[Array, "L M P"]) -> Float[Array, "L M P"]:
            return matmul(jnp.swapaxes(out, 1, 2), at)

    def slopes(dg: Array, sites: Array) -> Array:
        pairs = drop[:, None, sites] * fields[sites].T
        at = matmul(pairs.reshape(-1, len(sites)), dg)
        at = at.reshape(*pairs.shape[:2], dg.shape[1])
        return at[:, :-1] - leaves(at[:, :-1]) + lift[:, :, None] * at[:, -1:]

    return slopes


# Numbers of sites that a factor is made of: whichever is the first to be enough, or all.
_SIZES = (32, 64, 128, 224, 352)

# Σ g·R of the sites left out of the factor, at most: the square of each is neglected. In
# fits of one to three contacts, bars and palms that made χ² of 0.04 in 640 voltages, and of
# 2 where they start.
_WEAK = 0.3


def reduce_sites(
    resistance: Float[Array, "n n"], conductance: Float[Array, " n"], electrodes: int
) -> ContactReduction:
    """Reduces a contact on n sites, the last of which are the electrodes, to electrodes.

    The factor is of the strong sites alone. Let s = √g there and
    y = (I + sRs)⁻¹s·[1 R_ce]. Then q = s·y are the currents of the strong sites, and
    z = [1 R_ce] − R_ca·q the potentials everywhere. The weak sites add zᵀg·z to what q
    draws.
    **Arguments:** `resistance` R in one gauge, Ω; `conductance` g, S per site;
    `electrodes`: M.
    **Returns:** the reduction, with the field at all n sites.
    """
    n = len(resistance)
    sizes = [size for size in _SIZES if size < n]
    reduced = partial(_reduced, resistance, conductance, electrodes)
    if not sizes:
        return reduced(jnp.arange(n))
    weight = conductance * jnp.diagonal(resistance)
    highest, order = lax.top_k(weight, sizes[-1])
    beyond = weight.at[order].set(0).sum()
    # From the smallest up: as differences of sums they would be lost in rounding.
    after = beyond + jnp.cumsum(jnp.append(highest, 0)[::-1])[::-1]
    branch = (after[np.array(sizes)] > _WEAK).sum()
    some = [lambda order, k=k: reduced(order[:k]) for k in sizes]
    return lax.switch(branch, [*some, lambda _: reduced(jnp.arange(n))], order)


def _reduced(
    resistance: Array, conductance: Array, electrodes: int, at: Array
) -> ContactReduction:
    """Factors the sites `at`, and treats all others as weak."""
    own = jnp.diagonal(resistance)
    ends = jnp.concatenate([jnp.ones_like(own)[:, None], resistance[:, -electrodes:]], 1)
    rows, g = resistance[at], conductance[at]
    root = jnp.sqrt(g)[:, None]
    system = jnp.eye(len(at), dtype=g.dtype) + root * rows[:, at] * root.T
    chol = jnp.linalg.cholesky(system, symmetrize_input=False)
    half = triangular_solve(chol, root * ends[at], left_side=True, lower=True)
    y = triangular_solve(chol, half, left_side=True, lower=True, transpose_a=True)
    flow = root * y
    z = ends - matmul(rows.T, flow)
    # What is under a strong contact is y/s: as the difference it would lose its digits.
    strong = (g * own[at] > 1)[:, None]
    z = z.at[at].set(jnp.where(strong, y / jnp.where(strong, root, 1), z[at]))
    weak = conductance.at[at].set(0)[:, None]
    drawn = matmul(half.T, half) + matmul(z.T, weak * z)
    lift = drawn[0, 1:]
    return ContactReduction(
        drawn[0, 0],
        lift,
        1 - lift,
        resistance[-electrodes:, -electrodes:] - drawn[1:, 1:],
        z[:, 1:],
        z[:, 0],
    )
