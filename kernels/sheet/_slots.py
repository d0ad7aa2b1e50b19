"""Computes the slot map T and the Jacobian family J(ρ), from a table of resistances."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels.sheet._table import Resistances


def slot_map(
    table: Resistances,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
) -> Float[Array, "L M K"]:
    """Computes T^l_ik = R_ik − R_lk − R_il + R_ll + z (Ω); exactly, a slot's V = T^l s.

    s (A per element) is the current that the object feeds into the sheet.
    """
    ee, ek, _ = table
    z = jnp.broadcast_to(ground_resistance, ee.shape[:1])[grounds]
    offset = (ee[grounds, grounds] + z)[:, None] - ee[grounds]
    return ek[None] - ek[grounds][:, None] + offset[:, :, None]


def loop_resistance(
    table: Resistances,
    grounds: Int[Array, " L"],
    ground_resistance: Float[Array, "..."],
) -> Float[Array, "L K"]:
    """Computes R_kk + R_ll − 2R_lk + z (Ω): from element k through the sheet to l."""
    ee, ek, kk = table
    z = jnp.broadcast_to(ground_resistance, ee.shape[:1])[grounds]
    return kk + (ee[grounds, grounds] + z)[:, None] - 2 * ek[grounds]


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
