"""Makes XLA compile a function of many small operations as one."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
from jax.experimental.xla_metadata import set_xla_metadata

# Operations that XLA calls a library for, which it cannot from such a function.
_CALLS = ("sort", "top_k", "fft", "conv_general_dilated", "ffi_call", "pure_callback")
_CALLS += ("cholesky", "eigh", "eig", "svd", "qr", "lu", "triangular_solve", "householder")


def one_function(f: Callable) -> Callable:
    """Returns `f` as one function, to be called while a function around `f` is compiled.

    Otherwise XLA makes a task of each operation on a processor: some hundred tasks a step.
    Each task takes a third of a microsecond at least. The marks are XLA's own, for loops
    that XLA takes for small loops. An XLA without these marks compiles the tasks. So does
    any XLA where `f` needs a library.
    """
    inner = jax.jit(f)

    def marked(*given: Any) -> Any:
        names = set(_primitives(jax.make_jaxpr(inner)(*given).jaxpr))
        result = inner(*given)
        calls = any(name.startswith(_CALLS) for name in names)
        if jax.default_backend() != "cpu" or calls:
            return result
        leaves, tree = jax.tree.flatten(result)
        # A mark on one result is a mark on the call that it comes from.
        marks = {"inlineable": "false", "xla_cpu_small_call": "true"}
        leaves[0] = set_xla_metadata(leaves[0], **marks)
        return jax.tree.unflatten(tree, leaves)

    return marked


def _primitives(jaxpr: Any) -> Iterator[str]:
    """Yields the names of all operations, those of functions inside too."""
    for equation in jaxpr.eqns:
        yield equation.primitive.name
        for leaf in jax.tree.leaves(list(equation.params.values())):
            inside = getattr(leaf, "jaxpr", leaf)
            if hasattr(inside, "eqns"):
                yield from _primitives(inside)
