"""Computes one result in two ways, and takes the costlier way only where it is needed.

`tree_where` chooses between two pytrees, array by array.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool


def where_needed(
    whole: Callable[..., Any], simple: Callable[..., Any], together: int = 128
) -> Callable[..., Any]:
    """Makes a function (needed, *arrays): `whole(*arrays)` where needed, else `simple`.

    Both functions return arrays of the same shapes, and the same values where `needed` is
    False. A plain condition under `vmap` costs all frames both ways. Here all frames go the
    simple way, then those in need go the whole way, `together` at once.

    The functions take all arrays as arguments: they close over no traced array.
    """

    @custom_vmap
    def either(needed, *arrays):
        return lax.cond(needed, whole, simple, *arrays)

    @either.def_vmap
    def _(size, batched, needed, *arrays):
        axes = jax.tree.map(lambda one: 0 if one else None, tuple(batched[1:]))
        found = jax.vmap(simple, axes, axis_size=size)(*arrays)
        needed = jnp.broadcast_to(needed, (size,))
        n = min(together, size)
        order = jnp.argsort(~needed, stable=True)
        order = jnp.concatenate([order, jnp.broadcast_to(order[-1:], (n,))])

        def again(state: tuple) -> tuple:
            done, found = state
            these = lax.dynamic_slice_in_dim(order, done, n)
            some = jax.tree.map(
                lambda a, one: a[these] if one else a, arrays, tuple(batched[1:])
            )
            better = jax.vmap(whole, axes, axis_size=n)(*some)
            found = jax.tree.map(lambda a, b: a.at[these].set(b), found, better)
            return done + n, found

        left = needed.sum()
        start = jnp.zeros_like(left), found
        found = lax.while_loop(lambda state: state[0] < left, again, start)[1]
        return found, jax.tree.map(lambda _: True, found)

    # The rule above has no slopes in reverse; a plain condition has.
    @jax.custom_jvp
    def told(needed, *arrays):
        return either(needed, *arrays)

    @told.defjvp
    def _(primals, tangents):
        plain = partial(lax.cond, primals[0], whole, simple)
        return jax.jvp(plain, primals[1:], tangents[1:])

    return told


def tree_where(condition: Bool[Array, ""], one: Any, other: Any) -> Any:
    """Takes the arrays of `one` where the condition holds, else those of `other`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)
