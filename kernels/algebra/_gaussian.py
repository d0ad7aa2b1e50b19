"""Makes the matrix of a Gaussian blur along one side of an image."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


@partial(jax.jit, static_argnums=0)  # as one program to compile
def gaussian(count: int, length: Float[Array, ""]) -> Float[Array, "n n"]:
    """Returns exp(−(i − j)²/(2·length²))."""
    apart = jnp.asarray(np.arange(count)[:, None] - np.arange(count), length.dtype)
    return jnp.exp(-((apart / length) ** 2) / 2)
