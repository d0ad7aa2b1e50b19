"""Reads functions that `jax.export` wrote in another process."""

import jax
import jax.export

from tomojax._programs import prepare_lapack


def load_exported(serialized: bytes | bytearray) -> jax.export.Exported:
    """Reads a function that `jax.export` serialized, so that `.call` runs here.

    jaxlib knows its solvers' addresses only after a process has lowered one of them; an
    exported function that solves ends the process before (jax-ml/jax #29610). So one small
    solver is lowered first.

    **Example:**

    >>> import jax
    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rows = tx.jacobian(sensor, [0, 15])
    >>> image = jax.jit(lambda v: tx.reconstruct(rows, v, lam=1.0).image)
    >>> volts = np.ones((2, 16), np.float32)
    >>> kept = bytes(jax.export.export(image)(volts).serialize())
    >>> tx.paper.load_exported(kept).call(volts).shape == image(volts).shape
    True
    """
    prepare_lapack()
    return jax.export.deserialize(bytearray(serialized))
