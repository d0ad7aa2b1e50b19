"""Checks on the host: a `ValueError` names the argument, the value and the expectation.

Values under a trace (jit, grad, vmap) are unknown and pass. Shapes are always checked.
"""

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from tomojax._custom_types import Numbers
from tomojax._require import require as require

Rule = Literal["finite", "positive", "not negative"]  # of an array's numbers
Shape = tuple[int | None, ...]  # None: any length


def known(*values: Any) -> bool:
    """Tells whether the values are numbers now, not placeholders of a trace."""
    return not any(isinstance(v, Tracer) for v in values)


def float_array(name: str, value: Numbers, dtype: Any = None) -> jax.Array:
    """Returns `value` as an array of `dtype`; by default the value's own or JAX's float."""
    fine = dtype is None or _floating(dtype)
    require(fine, "dtype", repr(dtype), "float32 or float64")
    if not known(*jax.tree.leaves(value)):
        return jnp.asarray(value, dtype)
    try:
        array = np.asarray(value)
        if dtype is None:
            floating = np.issubdtype(array.dtype, np.floating) and hasattr(value, "dtype")
            # A NumPy float64 is JAX's float where x64 is off: no warning for that.
            dtype = jax.dtypes.canonicalize_dtype(array.dtype if floating else float)
        if array.dtype.kind in "USc":  # text that NumPy would read; complex numbers
            raise TypeError
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {value!r}, expected numbers") from None
    return jnp.asarray(array.astype(dtype), dtype)  # JAX would compile a conversion


def _floating(dtype: Any) -> bool:
    try:
        return jnp.dtype(dtype) in (np.float32, np.float64)
    except TypeError:
        return False


def require_array(name: str, value: jax.Array, rule: Rule, *shapes: Shape) -> None:
    """Checks the value's shape, where any are told, and its numbers by the rule."""
    if shapes:
        require_shape(name, value, *shapes)
    if not known(value):
        return
    array = np.asarray(value)
    bad, low = int((~np.isfinite(array)).sum()), array.min(initial=np.inf)
    require(bad == 0, name, f"{bad} values NaN or infinite", "numbers")
    require(rule != "positive" or low > 0, name, f"{low:g}", "values above 0")
    require(rule == "finite" or low >= 0, name, f"{low:g}", "values of 0 or above")


def require_indices(name: str, numbers: jax.Array, count: int) -> None:
    """Checks that `numbers` (n,), one at least, are from 0 to `count` − 1."""
    require_shape(name, numbers, (None,))
    require(numbers.size > 0, name, "none", "at least one")
    if known(numbers):
        host = np.asarray(numbers)  # of JAX each operation would be a program
        low, high = int(host.min()), int(host.max())
        inside = 0 <= low and high < count
        require(inside, name, f"{low} to {high}", f"0 to {count - 1}")


def checked(
    name: str, value: Numbers, rule: Rule, *shapes: Shape, dtype: Any = None
) -> jax.Array:
    """Returns `value` as `float_array` once `require_array` has passed it."""
    array = float_array(name, value, dtype)
    require_array(name, array, rule, *shapes)
    return array


def checking(name: str, rule: Rule, *shapes: Shape) -> Callable[[Numbers], jax.Array]:
    """Makes `checked` of this name: the converter of a module's field."""
    return lambda value: checked(name, value, rule, *shapes)


def require_shape(name: str, value: jax.Array, *shapes: Shape) -> None:
    """Checks the value's shape against any of `shapes`; None stands for any length."""

    def fits(shape: Shape) -> bool:
        return len(shape) == value.ndim and all(
            want is None or want == have for want, have in zip(shape, value.shape)
        )

    wanted = " or ".join(str(s).replace("None", "any") for s in shapes)
    require(any(map(fits, shapes)), name, f"shape {value.shape}", f"shape {wanted}")
