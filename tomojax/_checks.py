"""Checks on the host: a `ValueError` names the argument, the value and the expectation.

Values under a trace (jit, grad, vmap) are unknown and pass. Shapes are always checked.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from tomojax._custom_types import Numbers
from tomojax._require import require as require


def known(*values: Any) -> bool:
    """Tells whether the values are numbers now, not placeholders of a trace."""
    return not any(isinstance(v, Tracer) for v in values)


def float_array(name: str, value: Numbers, dtype: Any = None) -> jax.Array:
    """Returns `value` as an array of `dtype`; by default the value's own or JAX's float."""
    if not known(*jax.tree.leaves(value)):
        return jnp.asarray(value, dtype)
    try:
        array = np.asarray(value)
        if dtype is None:
            floating = np.issubdtype(array.dtype, np.floating) and hasattr(value, "dtype")
            # A NumPy float64 is JAX's float where x64 is off: no warning for that.
            dtype = jax.dtypes.canonicalize_dtype(array.dtype if floating else float)
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {value!r}, expected numbers") from None
    return jnp.asarray(array.astype(dtype), dtype)  # JAX would compile a conversion


def require_finite(name: str, value: jax.Array) -> None:
    if known(value):
        bad = ~np.isfinite(np.asarray(value))
        require(not bad.any(), name, f"{int(bad.sum())} values NaN or infinite", "numbers")


def require_positive(name: str, value: jax.Array) -> None:
    require_finite(name, value)
    if known(value):
        low = np.asarray(value).min(initial=np.inf)
        require(low > 0, name, f"{low:g}", "values above 0")


def require_not_negative(name: str, value: jax.Array) -> None:
    require_finite(name, value)
    if known(value):
        low = np.asarray(value).min(initial=np.inf)
        require(low >= 0, name, f"{low:g}", "values of 0 or above")


def require_within(name: str, numbers: jax.Array, count: int) -> None:
    if known(numbers):
        low, high = int(numbers.min()), int(numbers.max())
        inside = 0 <= low and high < count
        require(inside, name, f"{low} to {high}", f"0 to {count - 1}")


def checked(
    name: str,
    value: Numbers,
    check: Callable[[str, jax.Array], None],
    *shapes: tuple[int | None, ...],
    dtype: Any = None,
) -> jax.Array:
    """Returns `value` as `float_array`, of any of `shapes`, once `check` has passed it."""
    array = float_array(name, value, dtype)
    require_shape(name, array, *shapes)
    check(name, array)
    return array


def checking(
    name: str, check: Callable[[str, jax.Array], None], *shapes: tuple[int | None, ...]
) -> Callable[[Numbers], jax.Array]:
    """Makes `checked` of this name: the converter of a module's field."""

    def converted(value: Numbers) -> jax.Array:
        return checked(name, value, check, *shapes)

    return converted


def require_shape(name: str, value: jax.Array, *shapes: tuple[int | None, ...]) -> None:
    """Checks the value's shape against any of `shapes`; None stands for any length."""

    def fits(shape: tuple[int | None, ...]) -> bool:
        return len(shape) == value.ndim and all(
            want is None or want == have for want, have in zip(shape, value.shape)
        )

    wanted = " or ".join(str(s).replace("None", "any") for s in shapes)
    require(any(map(fits, shapes)), name, f"shape {value.shape}", f"shape {wanted}")
