"""Chooses between two pytrees, array by array."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def tree_where(condition: Bool[Array, ""], one: Any, other: Any) -> Any:
    """Takes the arrays of `one` where the condition holds, else those of `other`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)
