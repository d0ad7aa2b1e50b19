"""Packs many small arrays as two: each array costs a compiled call a microsecond."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax._shown import tuple_shown


class Packed(NamedTuple):
    """A pytree's numbers: two arrays, to be saved and restored unchanged.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> step = tx.make_step(sensor, "source", ["boundary"], contacts=1, grid=8)
    >>> isinstance(step.state, tx.step.Packed), step.state.numbers.ndim
    (True, 1)
    """

    # Of JAX's program or of C.
    numbers: Float[Array, "*batch n"] | Float[np.ndarray, "*batch n"]
    whole: Int[Array, "*batch k"] | Int[np.ndarray, "*batch k"]  # int32; also truths

    def __repr__(self) -> str:
        return tuple_shown(self)


# As a step gives it, or its two arrays as some file has kept them.
State = Packed | tuple[Any, Any]


def packed(state: State) -> Packed:
    """Returns a state as a step takes it."""
    return state if isinstance(state, Packed) else Packed(*state)


class Leaf(NamedTuple):
    """A leaf of a packed pytree: where it stands, and its shape and type."""

    number: bool  # whether among the numbers; else among the whole
    at: slice | int
    shape: tuple[int, ...]
    dtype: np.dtype
    kept: bool  # whether packing keeps its type


class Packing:
    """The packing of a pytree: an `example` gives shapes and types."""

    def __init__(self, example: Any, dtype: Any):
        leaves, self._tree = jax.tree.flatten(example)
        self._dtype = np.dtype(dtype)
        self._leaves: list[Leaf] = []
        ends = {True: 0, False: 0}
        for leaf in leaves:  # arrays, or what has their shapes and types
            kind, shape = np.dtype(leaf.dtype), leaf.shape
            number = kind.kind == "f"
            start = ends[number]
            ends[number] = start + int(np.prod(shape))
            at = slice(start, ends[number]) if shape else start
            kept = number or kind == np.int32
            self._leaves.append(Leaf(number, at, shape, kind, kept))
        self._sizes = ends[True], ends[False]

    @property
    def sizes(self) -> tuple[int, int]:
        """How many numbers and whole numbers there are."""
        return self._sizes

    def pack(self, tree: Any) -> Packed:
        """Packs a pytree into two arrays; compiled."""
        numbers, whole = [jnp.zeros(0, self._dtype)], [jnp.zeros(0, jnp.int32)]
        for about, leaf in zip(self._leaves, jax.tree.leaves(tree)):
            if about.number:
                numbers.append(leaf.ravel())
            else:
                whole.append(leaf.ravel().astype(jnp.int32))
        return Packed(jnp.concatenate(numbers), jnp.concatenate(whole))

    def unpack(self, packed: tuple[Any, Any]) -> Any:
        """Unpacks the pytree: compiled, or in NumPy for NumPy's arrays."""
        numbers, whole = packed
        leaves = []
        for about in self._leaves:
            leaf = (numbers if about.number else whole)[..., about.at]
            if len(about.shape) > 1:
                leaf = leaf.reshape((*leaf.shape[:-1], *about.shape))
            leaves.append(leaf if about.kept else leaf.astype(about.dtype))
        return jax.tree.unflatten(self._tree, leaves)
