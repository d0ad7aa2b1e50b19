"""Computes volts per ampere of a slot, the slot map T and the Jacobian family J(ρ).

An ampere enters the sheet where its potentials at the electrodes are R_i, and leaves at the
grounded electrode l through z. In that slot electrode i is at

    R_i − R_l + (R_ll + z − R_il)

`ground_path`, `slot_offset` and `volts_per_ampere` take arrays of NumPy and of JAX.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels.sheet._table import Resistances

A = TypeVar("A", Array, np.ndarray)


def ground_path(
    electrodes: Float[A, "M M"],
    grounds: Int[A, "*L"],
    ground_resistance: Float[A, "..."] | float,
) -> Float[A, "*L"]:
    """Computes R_ll + z (Ω), z one value or one for each electrode."""
    z = ground_resistance
    each = z[grounds] if np.ndim(z) else z  # pyright: ignore
    return electrodes[grounds, grounds] + each


def slot_offset(
    electrodes: Float[A, "M M"],
    grounds: Int[A, "*L"],
    ground_resistance: Float[A, "..."] | float,
) -> Float[A, "*L M"]:
    """Computes R_ll + z − R_il (Ω): all but what depends on where the current enters."""
    own = ground_path(electrodes, grounds, ground_resistance)
    return own[..., None] - electrodes[grounds]


def volts_per_ampere(
    potential: Float[A, "*batch M"],
    electrodes: Float[A, "M M"],
    grounds: Int[A, " L"],
    ground_resistance: Float[A, "..."] | float,
    total: Float[A, "*#batch"] | float = 1.0,
) -> Float[A, "*batch L M"]:
    """Computes R_i − R_l + total·(R_ll + z − R_il), Ω.

    `potential` is R, or a mix of several whose weights add up to `total`.
    """
    offset = slot_offset(electrodes, grounds, ground_resistance)
    share = total[..., None, None] if np.ndim(total) else total  # pyright: ignore
    return potential[..., None, :] - potential[..., grounds][..., None] + share * offset


def slot_map(
    table: Resistances,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
) -> Float[Array, "L M K"]:
    """Computes T^l_ik = R_ik − R_lk − R_il + R_ll + z (Ω); exactly, a slot's V = T^l s.

    s (A per element) is the current that the object feeds into the sheet.
    """
    ee, ek, _ = table
    offset = slot_offset(ee, grounds, ground_resistance)
    return ek[None] - ek[grounds][:, None] + offset[:, :, None]


def loop_resistance(
    table: Resistances,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
) -> Float[Array, "L K"]:
    """Computes R_kk + R_ll − 2R_lk + z (Ω): from element k through the sheet to l."""
    ee, ek, kk = table
    return kk + ground_path(ee, grounds, ground_resistance)[:, None] - 2 * ek[grounds]


def slot_jacobian(
    table: Resistances,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
    contact_resistance: Float[Array, "..."],
) -> Float[Array, "L M K"]:
    """Computes `contact_jacobian` of slots with one electrode grounded."""
    t = slot_map(table, grounds, ground_resistance)
    loop = loop_resistance(table, grounds, ground_resistance)
    return contact_jacobian(t, loop, contact_resistance)


def shared_slot_map(
    table: Resistances, to_ground: Float[Array, "L M"]
) -> tuple[Float[Array, "L M K"], Float[Array, "L K"]]:
    """Computes T and loop resistances with a conductance γ_e (S) to ground per electrode.

    (I + R_eeΓ)x = 1, (I + R_eeΓ)Y = R_ek; the sheet's mean potential per ampere is
    m = (1 − 1ᵀΓY)/(1ᵀΓx); T = x·m + Y and the loop is R_kk − R_keΓT_·k + m. At least one γ
    must be positive; otherwise the result is infinite.
    """
    ee, ek, kk = table

    def one(gamma: Float[Array, " M"]) -> tuple[Array, Array]:
        system = jnp.eye(len(ee), dtype=ee.dtype) + ee * gamma
        rhs = jnp.concatenate([jnp.ones_like(ek[:, :1]), ek], 1)
        solution = jnp.linalg.solve(system, rhs)
        x, y = solution[:, :1], solution[:, 1:]
        through = jnp.matmul(gamma, solution, precision="highest")
        mean = (1 - through[1:]) / through[0]
        t = x * mean + y
        back = jnp.einsum("ek,e,ek->k", ek, gamma, t, precision="highest")
        return t, kk - back + mean

    return jax.vmap(one)(to_ground)


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
