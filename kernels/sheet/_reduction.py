"""Reduces a sheet in contact to its electrodes: exact for any contact and ground.

Pin the sheet's reference at one place. Let j be the currents that the electrodes draw, and
D the object's potential above the reference. For a contact g

    v = V0·1 − f·D − Q·j,   p·D = fᵀj,   u_k = V0 − c_k·D − X_k·j

So M voltages can tell only p, f and Q of a contact; a ground only says how j follows from
v. No term cancels when the contact is weak or strong. A contact has sites k: nodes of a
mesh, elements, or electrodes.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.sheet._slots import ground_path


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


def _ground(
    contact: ContactReduction, grounds: Int[Array, " L"], ground_resistance: Array
) -> _Ground:
    q, f = contact.resistance[grounds], contact.shortfall[grounds]
    total = ground_path(contact.resistance, grounds, ground_resistance)
    return _Ground(q, total, f, contact.lift[grounds], contact.conductance * total + f**2)


def ground_voltages(
    contact: ContactReduction,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
    drive_voltage: Float[Array, ""],
) -> Float[Array, "L M"]:
    """Computes all M voltages (V) under each ground condition, one electrode grounded.

    V_i^l = V0·[p(z + Q_ll − Q_il) + f_l(b_i − b_l)] / [p(z + Q_ll) + f_l²].
    """
    g = _ground(contact, grounds, ground_resistance)
    through = contact.conductance * (g.total[:, None] - g.q)
    around = g.f[:, None] * (contact.lift[None, :] - g.b[:, None])
    return drive_voltage * (through + around) / g.denominator[:, None]


def voltage_drop(
    contact: ContactReduction,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
    drive_voltage: Float[Array, ""],
) -> Float[Array, "L sites"]:
    """Computes V0 − u_k^l (V), which drives the current s_k = g_k(V0 − u_k) into a site."""
    g = _ground(contact, grounds, ground_resistance)
    drop = g.f[:, None] * contact.gap + contact.conductance * contact.field.T[grounds]
    return drive_voltage * drop / g.denominator[:, None]


def _answers(
    contact: ContactReduction, grounds: Int[Array, " L"], ground_resistance: Array
) -> tuple[Float[Array, "L M"], Float[Array, "L M"], Float[Array, "sites fields"]]:
    """Computes t_il, the factor of c in ψ_i^l, and the fields [X c] of the sites.

    The adjoint derivative is ∂V_i^l/∂g_k = ψ_i^l(k)·(V0 − u_k^l), V/S. Here ψ_i^l is the
    potential of a unit current into electrode i, with the ground l and the object at 0 V.
    Its value at k is X_ki − t_il·X_kl + c_k·[f_i(z + Q_ll) − f_l·Q_il]/d_l. The factors are
    t_il = (p·Q_il + f_i·f_l)/d_l and d_l = p(z + Q_ll) + f_l². At g = 0 ψ is T.
    """
    g = _ground(contact, grounds, ground_resistance)
    f, over = contact.shortfall, 1 / g.denominator[:, None]
    share = (contact.conductance * g.q + f * g.f[:, None]) * over
    lift = (f * g.total[:, None] - g.f[:, None] * g.q) * over
    return share, lift, jnp.concatenate([contact.field, contact.gap[:, None]], 1)


def voltage_slopes(
    contact: ContactReduction,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
    drive_voltage: Float[Array, ""],
) -> Callable[[Float[Array, "some P"], Int[Array, " some"]], Float[Array, "L M P"]]:
    """Makes a map from ∂g/∂(P parameters) at some sites to ∂V_i^l/∂(parameters), V.

    The map takes ∂g and the sites' numbers. Slopes are products of L + M fields: one
    product of matrices does for all parameters, without the L·M·sites numbers of ∂V/∂g.
    """
    share, lift, fields = _answers(contact, grounds, ground_resistance)
    drop = voltage_drop(contact, grounds, ground_resistance, drive_voltage)

    def slopes(dg: Array, sites: Array) -> Array:
        pairs = drop[:, None, sites] * fields[sites].T
        at = matmul(pairs.reshape(-1, len(sites)), dg)
        at = at.reshape(*pairs.shape[:2], dg.shape[1])
        own = jnp.take_along_axis(at, grounds[:, None, None], 1)
        return at[:, :-1] - share[:, :, None] * own + lift[:, :, None] * at[:, -1:]

    return slopes


def shared_ground_voltages(
    contact: ContactReduction,
    to_ground: Float[Array, "L M"],
    drive_voltage: Float[Array, ""],
) -> Float[Array, "L M"]:
    """Computes voltages (V) with a conductance γ_e (S) to ground at any electrodes.

    j = Γv gives v = x·E + V0·y with (I + QΓ)x = f, (I + QΓ)y = b and E = V0 − D =
    V0·(p − fᵀΓy)/(p + fᵀΓx). Without contact or ground the sheet floats and 0 V is
    returned.
    """

    def one(gamma: Float[Array, " M"]) -> Float[Array, " M"]:
        q, f, p = contact.resistance, contact.shortfall, contact.conductance
        system = jnp.eye(len(q), dtype=q.dtype) + q * gamma
        x, y = jnp.linalg.solve(system, jnp.stack([f, contact.lift], 1)).T
        numerator = p - jnp.vdot(f * gamma, y, precision="highest")
        denominator = p + jnp.vdot(f * gamma, x, precision="highest")
        floating = denominator == 0
        excess = jnp.where(floating, 0, numerator / jnp.where(floating, 1, denominator))
        return drive_voltage * (x * excess + y)

    return jax.vmap(one)(to_ground)
